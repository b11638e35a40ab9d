# SPDX-License-Identifier: Apache-2.0
"""HTML page and figures of an experiment."""
