# SPDX-License-Identifier: Apache-2.0
"""Control group limits, read from fixture trees: v1, v2, hybrid without controllers, containers."""

from pathlib import Path

import pytest

from edgectl.agent.measure import cgroup, cgroup_usage


def tree(root: Path, files: dict[str, str]) -> str:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return str(root)


V1 = {
    "proc/self/cgroup": "5:memory:/box/inner\n4:cpuacct:/box/inner\n3:cpu:/box/inner\n1:name=systemd:/x\n0::/\n",
    "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "-1\n",
    "sys/fs/cgroup/cpu/box/cpu.cfs_quota_us": "40000\n",
    "sys/fs/cgroup/cpu/box/cpu.cfs_period_us": "100000\n",
    "sys/fs/cgroup/cpu/box/inner/cpu.cfs_quota_us": "-1\n",
    "sys/fs/cgroup/cpu/box/inner/cpu.cfs_period_us": "100000\n",
    "sys/fs/cgroup/cpuacct/box/cpuacct.usage": "2500000000\n",
    "sys/fs/cgroup/memory/memory.limit_in_bytes": "9223372036854771712\n",
    "sys/fs/cgroup/memory/box/memory.limit_in_bytes": "1073741824\n",
    "sys/fs/cgroup/memory/box/memory.usage_in_bytes": "500000000\n",
    "sys/fs/cgroup/memory/box/memory.stat": "cache 1\ntotal_cache 200000000\ntotal_shmem 50000000\n",
    "sys/fs/cgroup/memory/box/inner/memory.limit_in_bytes": "9223372036854771712\n",
    "sys/fs/cgroup/unified/cgroup.controllers": "hugetlb\n",
}
V2 = {
    "proc/self/cgroup": "0::/user.slice/user-1000.slice\n",
    "sys/fs/cgroup/cgroup.controllers": "cpuset cpu io memory pids\n",
    "sys/fs/cgroup/user.slice/cpu.max": "150000 100000\n",
    "sys/fs/cgroup/user.slice/cpu.stat": "usage_usec 7500000\nuser_usec 1\n",
    "sys/fs/cgroup/user.slice/memory.max": "max\n",
    "sys/fs/cgroup/user.slice/user-1000.slice/cpu.max": "max 100000\n",
    "sys/fs/cgroup/user.slice/user-1000.slice/memory.max": "536870912\n",
    "sys/fs/cgroup/user.slice/user-1000.slice/memory.current": "300000000\n",
    "sys/fs/cgroup/user.slice/user-1000.slice/memory.stat": "anon 1\nfile 120000000\nshmem 20000000\n",
}


def test_v1_limit_of_a_parent_counts(tmp_path: Path) -> None:
    root = tree(tmp_path, V1)
    limit = cgroup.find_cpu_limit(root)
    assert limit is not None
    assert limit.value == 0.4
    assert cgroup_usage.read_cpu_used_s(limit, root) == 2.5
    memory = cgroup.find_memory_limit(root)
    assert memory is not None
    assert memory.value == 1 << 30
    # 500 MB in use, 200 MB of it page cache, of which 50 MB are shared memory and not reclaimable.
    assert cgroup_usage.read_memory_used(memory) == 350_000_000


def test_v2_smallest_limit_on_the_way_up_counts(tmp_path: Path) -> None:
    root = tree(tmp_path, V2)
    limit = cgroup.find_cpu_limit(root)
    assert limit is not None
    assert limit.value == 1.5
    assert cgroup_usage.read_cpu_used_s(limit, root) == 7.5
    memory = cgroup.find_memory_limit(root)
    assert memory is not None
    assert memory.value == 1 << 29
    assert cgroup_usage.read_memory_used(memory) == 200_000_000


def test_v1_joint_hierarchy(tmp_path: Path) -> None:
    files = {
        "proc/self/cgroup": "3:cpu,cpuacct:/box\n0::/\n",
        "sys/fs/cgroup/cpu,cpuacct/box/cpu.cfs_quota_us": "200000",
        "sys/fs/cgroup/cpu,cpuacct/box/cpu.cfs_period_us": "100000",
        "sys/fs/cgroup/cpu,cpuacct/box/cpuacct.usage": "3000000000",
    }
    root = tree(tmp_path, files)
    limit = cgroup.find_cpu_limit(root)
    assert limit is not None
    assert (limit.value, cgroup_usage.read_cpu_used_s(limit, root)) == (2.0, 3.0)


def test_container_that_sees_only_its_own_group(tmp_path: Path) -> None:
    """Without a cgroup namespace /proc shows a path that is mounted as the root."""
    files = {
        "proc/self/cgroup": "3:cpu:/docker/abc\n",
        "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "50000",
        "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000",
    }
    limit = cgroup.find_cpu_limit(tree(tmp_path, files))
    assert limit is not None
    assert limit.value == 0.5


@pytest.mark.parametrize(
    "files",
    [
        {},
        {"proc/self/cgroup": "0::/\n"},
        {"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/unified/cgroup.controllers": "hugetlb\n"},
        {
            "proc/self/cgroup": "0::/a\n",
            "sys/fs/cgroup/cgroup.controllers": "cpu memory\n",
            "sys/fs/cgroup/a/cpu.max": "max 100000\n",
        },
        {
            "proc/self/cgroup": "garbage",
            "sys/fs/cgroup/cgroup.controllers": "cpu memory\n",
            "sys/fs/cgroup/cpu.max": "x y\n",
        },
    ],
)
def test_no_limit_where_none_can_be_read(tmp_path: Path, files: dict[str, str]) -> None:
    root = tree(tmp_path, files)
    assert cgroup.find_cpu_limit(root) is None
    assert cgroup.find_memory_limit(root) is None


CONTAINER = "ab" * 32


def test_usage_of_a_container_by_its_process_in_v1(tmp_path: Path) -> None:
    root = tree(
        tmp_path,
        V1
        | {
            "proc/77/cgroup": f"5:memory:/docker/{CONTAINER}\n4:cpuacct:/docker/{CONTAINER}\n3:cpu:/x\n0::/\n",
            f"sys/fs/cgroup/cpuacct/docker/{CONTAINER}/cpuacct.usage": "1500000000\n",
            f"sys/fs/cgroup/memory/docker/{CONTAINER}/memory.usage_in_bytes": "90000000\n",
            f"sys/fs/cgroup/memory/docker/{CONTAINER}/memory.stat": "total_cache 30000000\ntotal_shmem 10000000\n",
        },
    )
    assert cgroup_usage.read_container_cpu_s(77, root) == 1.5
    assert cgroup_usage.read_container_memory(77, root) == 70_000_000
    assert (cgroup_usage.read_container_cpu_s(78, root), cgroup_usage.read_container_memory(78, root)) == (
        -1.0,
        -1,
    )


def test_usage_of_a_container_by_its_process_in_v2(tmp_path: Path) -> None:
    scope = f"sys/fs/cgroup/system.slice/docker-{CONTAINER}.scope"
    root = tree(
        tmp_path,
        V2
        | {
            "proc/77/cgroup": f"0::/system.slice/docker-{CONTAINER}.scope\n",
            f"{scope}/cpu.stat": "usage_usec 2500000\n",
            f"{scope}/memory.current": "50000000\n",
            f"{scope}/memory.stat": "file 20000000\nshmem 5000000\n",
        },
    )
    assert cgroup_usage.read_container_cpu_s(77, root) == 2.5
    assert cgroup_usage.read_container_memory(77, root) == 35_000_000
