# SPDX-License-Identifier: Apache-2.0
"""Quality of plans: how far from the best ones, measured on generated fleets."""
