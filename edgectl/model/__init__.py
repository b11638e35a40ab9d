# SPDX-License-Identifier: Apache-2.0
"""The nouns: frozen, slotted, keyword-only dataclasses. Nothing here does I/O."""
