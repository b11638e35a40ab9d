# SPDX-License-Identifier: Apache-2.0
"""Rules from facts to findings, each with a remedy: a command or an edit. Pure."""
