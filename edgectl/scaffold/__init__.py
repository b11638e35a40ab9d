# SPDX-License-Identifier: Apache-2.0
"""The files of ``edgectl init``: links to the ones at the top of the repository, real files in a wheel."""
