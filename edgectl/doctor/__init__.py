"""From facts to findings: pure rules, each with the command or edit that mends what it complains of."""
