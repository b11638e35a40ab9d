# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 and eqs. (1)-(5): pure functions from values to an Assignment."""
