"""Transports to a host: ssh, openssh, local and fake behind one Protocol."""
