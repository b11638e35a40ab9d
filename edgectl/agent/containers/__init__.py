# SPDX-License-Identifier: Apache-2.0
"""Tasks in containers: an engine (docker, podman) runs them, a supervisor watches them as commands."""
