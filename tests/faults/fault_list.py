# SPDX-License-Identifier: Apache-2.0
"""All faults, in the order of the table."""

from tests.faults import (
    faults_agent,
    faults_engine,
    faults_etcd,
    faults_etcd_members,
    faults_failover,
    faults_failpoints,
    faults_host,
    faults_image,
    faults_inventory,
    faults_link,
    faults_manager,
    faults_noise,
    faults_ownership,
    faults_random,
    faults_standby,
    faults_task,
    faults_two_managers,
    faults_warm_move,
)
from tests.faults.registry import FAULTS, Fault

MODULES = (
    faults_failpoints,
    faults_host,
    faults_inventory,
    faults_link,
    faults_agent,
    faults_manager,
    faults_two_managers,
    faults_etcd,
    faults_etcd_members,
    faults_ownership,
    faults_task,
    faults_noise,
    faults_failpoints,
    faults_standby,
    faults_warm_move,
    faults_failover,
    faults_engine,
    faults_image,
    faults_random,
)


def list_faults() -> list[Fault]:
    """Return the registered faults; importing the modules registers them."""
    assert MODULES
    return FAULTS
