# SPDX-License-Identifier: Apache-2.0
"""Rules that several rooms share: pure functions over the model."""
