"""All facts of a fleet -> all findings."""

from edgectl.doctor.host import host_findings
from edgectl.doctor.manager import manager_findings
from edgectl.doctor.ros import ros_findings
from edgectl.doctor.unanswered import unanswered
from edgectl.model.finding import Answers, Diagnosis, HostFacts, ManagerFacts
from edgectl.model.inventory import Inventory


def judge(inventory: Inventory, manager: ManagerFacts, answers: Answers) -> Diagnosis:
    """Findings about this machine, then host by host in the order of the inventory; ``answers`` holds the hosts that were asked."""
    findings = manager_findings(inventory, manager)
    facts = {name: answer for name, answer in answers.items() if isinstance(answer, HostFacts)}
    ros = ros_findings(inventory, facts)
    for name, host in inventory.hosts.items():
        answer = answers.get(name)
        if isinstance(answer, HostFacts):
            findings += [*host_findings(host, answer, inventory), *ros.get(name, ())]
        elif answer is not None:
            findings.append(unanswered(host, answer))
    return Diagnosis(findings=tuple(findings))
