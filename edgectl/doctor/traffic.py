"""Check of the traffic between an edge and the robots: whether all of it is seen."""

from edgectl.model.diagnosis import Finding, Severity
from edgectl.model.snapshot import Snapshot


def diagnose_traffic(host: str, snapshot: Snapshot | None) -> list[Finding]:
    """One finding for the links of an edge whose traffic is seen only in part."""
    sample = None if snapshot is None else snapshot.hosts.get(host)
    gaps = {} if sample is None else {robot: link.partial for robot, link in sample.links.items()}
    robots = [robot for robot, gap in gaps.items() if gap]
    if sample is None or not robots:
        return []
    tasks = [name for name, task in sample.tasks.items() if task.partial and task.state.alive]
    shown = f" of {', '.join(tasks)}" if tasks else ""
    return [
        Finding(
            host=host,
            check="traffic",
            level=Severity.WARNING,
            message=f"partial: {gaps[robots[0]]}{shown} to {', '.join(robots)}; the declared demand stands",
            remedy="declare it in the task file: demand: {throughput: ..}, as a subscriber counts it",
        )
    ]
