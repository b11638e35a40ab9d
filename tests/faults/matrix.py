"""All faults of the list, in its order."""

from tests.faults import (
    faults_host,
    faults_link,
    faults_manager,
    faults_noise,
    faults_points,
    faults_random,
    faults_task,
)
from tests.faults.registry import FAULTS, Fault

MODULES = (
    faults_points,
    faults_host,
    faults_link,
    faults_manager,
    faults_task,
    faults_noise,
    faults_points,
    faults_random,
)


def faults() -> list[Fault]:
    """The registered faults; importing the modules has put them there."""
    assert MODULES
    return FAULTS
