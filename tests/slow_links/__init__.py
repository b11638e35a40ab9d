# SPDX-License-Identifier: Apache-2.0
"""Commands over slow and lossy lines, beside ``ssh`` doing the same: ``make slow-links``."""
