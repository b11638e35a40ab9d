# SPDX-License-Identifier: Apache-2.0
"""The JSON documents that other programs may rely on: snapshot and plan, to and from the model. Pure."""
