# SPDX-License-Identifier: Apache-2.0
"""Kubernetes: a Deployment for a service, a Job for what completes, on the nodes of the plan (ADR 157)."""

import math
from collections.abc import Mapping, Sequence

from edgectl.export.engine_task import (
    PROBE_PERIOD_S,
    EngineFiles,
    EngineTask,
    check_images,
    note_common_gaps,
    select_probe,
)
from edgectl.model.check import OnUnhealthy
from edgectl.model.image import ContainerImage, PullPolicy
from edgectl.model.secret import Secret
from edgectl.model.task import HandoffOrder, RestartPolicy

Manifest = dict[str, object]
NODE_LABEL = "kubernetes.io/hostname"
_PULL = {PullPolicy.MISSING: "IfNotPresent", PullPolicy.ALWAYS: "Always", PullPolicy.NEVER: "Never"}


def build_manifests(tasks: Sequence[EngineTask], fleet: str) -> EngineFiles:
    """One file for each task: a list of manifests.

    Raises:
        UsageError: a task has no image.
    """
    check_images(tasks, "Kubernetes")
    files = EngineFiles()
    for each in tasks:
        _note_kubernetes_gaps(files, each)
        files.files[f"{each.label}.yaml"] = _list_manifests(each, _build_labels(each, fleet))
    return files


def _build_labels(each: EngineTask, fleet: str) -> dict[str, str]:
    return {
        "app.kubernetes.io/name": each.label,
        "app.kubernetes.io/part-of": fleet,
        "app.kubernetes.io/managed-by": "edgectl",
    }


def _list_manifests(each: EngineTask, labels: Mapping[str, str]) -> list[Manifest]:
    named = {"name": each.label, "labels": dict(labels)}
    selector = {"matchLabels": {"app.kubernetes.io/name": each.label}}
    pod = {"metadata": {"labels": dict(labels)}, "spec": _build_pod(each)}
    if each.completes:
        retries = {"backoffLimit": 0} if each.task.restart is RestartPolicy.NEVER else {}
        return [
            {"apiVersion": "batch/v1", "kind": "Job", "metadata": named, "spec": {**retries, "template": pod}}
        ]
    first = each.task.handoff.order is HandoffOrder.START_FIRST
    rolling = {"type": "RollingUpdate", "rollingUpdate": {"maxSurge": 1, "maxUnavailable": 0}}
    deployment = {"replicas": 1, "selector": selector, "strategy": rolling if first else {"type": "Recreate"}}
    return [
        {
            "apiVersion": "apps/v1",
            "kind": "Deployment",
            "metadata": named,
            "spec": {**deployment, "template": pod},
        },
        # A node is drained only once the task has been moved away.
        {
            "apiVersion": "policy/v1",
            "kind": "PodDisruptionBudget",
            "metadata": named,
            "spec": {"minAvailable": 1, "selector": selector},
        },
    ]


def _build_pod(each: EngineTask) -> Manifest:
    image = _get_image(each)
    pod: Manifest = {
        "affinity": _build_affinity(each.host.name),
        "terminationGracePeriodSeconds": math.ceil(each.task.stop.grace),
        "containers": [_build_container(each, image)],
    }
    if each.completes:
        again = each.task.restart is not RestartPolicy.NEVER
        pod["restartPolicy"] = "OnFailure" if again else "Never"
    if image.network == "host":
        pod |= {"hostNetwork": True, "dnsPolicy": "ClusterFirstWithHostNet"}
    if image.ipc == "host":
        pod["hostIPC"] = True
    mounts = _list_mounts(image)
    if mounts:
        pod["volumes"] = [{"name": name, "hostPath": {"path": parts[0]}} for name, parts in mounts]
    return pod


def _get_image(each: EngineTask) -> ContainerImage:
    return each.image or ContainerImage(name="")


def _build_affinity(node: str) -> Manifest:
    here = {"key": NODE_LABEL, "operator": "In", "values": [node]}
    terms = {"nodeSelectorTerms": [{"matchExpressions": [here]}]}
    return {"nodeAffinity": {"requiredDuringSchedulingIgnoredDuringExecution": terms}}


def _build_container(each: EngineTask, image: ContainerImage) -> Manifest:
    task = each.task
    container: Manifest = {"name": each.label, "image": image.name, "imagePullPolicy": _PULL[image.pull]}
    if task.command:
        container["command"] = ["/bin/sh", "-c", _escape_dollars(task.command)]
    if task.workdir:
        container["workingDir"] = task.workdir
    container["env"] = [_build_variable(each, name, value) for name, value in each.env.items()]
    container["resources"] = _build_resources(each, image)
    container |= _build_probes(each)
    ids = (image.user or "").split(":")
    if ids[0].isdigit():
        numbers = dict(zip(("runAsUser", "runAsGroup"), map(int, filter(str.isdigit, ids)), strict=False))
        container["securityContext"] = numbers
    mounts = _list_mounts(image)
    if mounts:
        container["volumeMounts"] = [_build_mount(name, parts) for name, parts in mounts]
    return container


def _build_variable(each: EngineTask, name: str, value: str) -> Manifest:
    if isinstance(value, Secret):
        return {"name": name, "valueFrom": {"secretKeyRef": {"name": f"{each.label}-env", "key": name}}}
    return {"name": name, "value": _escape_dollars(value)}


def _escape_dollars(text: str) -> str:
    """``text`` with each dollar doubled: Kubernetes fills in ``$(NAME)`` in commands and variables."""
    return text.replace("$", "$$")


def _build_resources(each: EngineTask, image: ContainerImage) -> Manifest:
    caps = each.task.limits
    requests = {
        "cpu": _format_cores(each.demand.get("cpu")),
        "memory": _format_bytes(each.demand.get("memory")),
    }
    limits = {"cpu": _format_cores(caps.cpu), "memory": _format_bytes(caps.memory)}
    gpus = count_gpus(each, image)
    if gpus:
        limits["nvidia.com/gpu"] = str(gpus)
    stated = {"requests": requests, "limits": limits}
    kept = {name: {key: text for key, text in amounts.items() if text} for name, amounts in stated.items()}
    return {name: amounts for name, amounts in kept.items() if amounts}


def count_gpus(each: EngineTask, image: ContainerImage) -> int:
    """Whole GPUs for a task: as its image states, else its demand rounded up."""
    if image.gpus is not None:
        return int(image.gpus) if image.gpus.isdigit() else 1
    return math.ceil(each.demand.get("gpu", 0.0))


def _format_cores(cores: float | None) -> str:
    return f"{math.ceil(cores * 1000)}m" if cores else ""


def _format_bytes(amount: float | None) -> str:
    return str(math.ceil(amount)) if amount else ""


def _build_probes(each: EngineTask) -> Manifest:
    task, probes = each.task, {}
    ready, alive = select_probe(task.ready), select_probe(task.alive.check if task.alive else None)
    if ready is not None and task.ready is not None:
        probes["readinessProbe"] = _build_probe(ready, task.ready.timeout)
    if alive is not None and task.alive is not None and task.alive.on_unhealthy is OnUnhealthy.RESTART:
        misses = max(1, math.ceil(task.alive.after / PROBE_PERIOD_S))
        probes["livenessProbe"] = _build_probe(alive, task.alive.check.timeout) | {"failureThreshold": misses}
    return dict(probes)


def _build_probe(command: str, timeout: float) -> Manifest:
    seconds = max(1, min(math.ceil(timeout), int(PROBE_PERIOD_S)))
    return {
        "exec": {"command": ["/bin/sh", "-c", command]},
        "periodSeconds": int(PROBE_PERIOD_S),
        "timeoutSeconds": seconds,
    }


def _list_mounts(image: ContainerImage) -> list[tuple[str, list[str]]]:
    """(name, [path on the host, path in the container, options]) of volumes and devices."""
    found = [each.split(":") for each in (*image.volumes, *image.devices)]
    return [
        (f"v{number}", [parts[0], parts[1] if len(parts) > 1 else parts[0], *parts[2:]])
        for number, parts in enumerate(found)
    ]


def _build_mount(name: str, parts: Sequence[str]) -> Manifest:
    read_only = {"readOnly": True} if "ro" in ",".join(parts[2:]).split(",") else {}
    return {"name": name, "mountPath": parts[1], **read_only}


def _note_kubernetes_gaps(files: EngineFiles, each: EngineTask) -> None:
    task, image = each.task, _get_image(each)
    if each.needs:
        files.add_note(each, "needs are left out: Kubernetes orders no starts")
    if task.stop.signal != "TERM":
        files.add_note(each, f"stop signal {task.stop.signal} is left out: the image states it (STOPSIGNAL)")
    if image.gpus == "all":
        files.add_note(each, "gpus: all became one nvidia.com/gpu")
    if image.devices:
        files.add_note(each, "devices are mounted as paths; access to them needs a device plugin")
    if image.user and not image.user.split(":")[0].isdigit():
        files.add_note(each, "a user by name is left out: Kubernetes takes numbers")
    if task.alive is not None and task.alive.on_unhealthy is not OnUnhealthy.RESTART:
        files.add_note(each, "alive is left out: it only reports, and a liveness probe restarts")
    note_common_gaps(files, each, secrets="a Secret named TASK-env, with a key for each variable")
