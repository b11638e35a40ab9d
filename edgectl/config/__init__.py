# SPDX-License-Identifier: Apache-2.0
"""Reading of YAML and JSON files into the model; every error has file, line, column, the line, a caret and a
hint.
"""
