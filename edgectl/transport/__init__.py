# SPDX-License-Identifier: Apache-2.0
"""Transports to a host: ssh, openssh, local and fake behind one Protocol."""
