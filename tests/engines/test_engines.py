# SPDX-License-Identifier: Apache-2.0
"""The same sweep on this machine, Ray, Dask and Slurm: the same bytes."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / ".venv-engines" / "bin" / "python"
SPEC = """version: 1
name: engines
scenario: {scenario}
schemes: {{policies: [static, local]}}
runs: 2
vary:
  - robot_cores: [2, 1]
    every: [30s, 25s]
"""


def sweep(spec: Path, out: Path, *more: str, environment: dict[str, str] | None = None) -> tuple[str, str]:
    """What the sweep prints as JSON, and on stderr."""
    command = [
        str(PYTHON),
        "-m",
        "edgectl",
        "simulate",
        "sweep",
        str(spec),
        "--out",
        str(out),
        "-o",
        "json",
        *more,
    ]
    given = {
        **(environment or os.environ),
        "PYTHONPATH": str(ROOT),
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    }
    done = subprocess.run(
        command, env=given, cwd=spec.parent, capture_output=True, text=True, timeout=280, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "engines.yaml"
    path.write_text(SPEC.format(scenario=ROOT / "docs" / "scenarios" / "paper-2.yaml"))
    return path


@pytest.fixture
def expected(spec: Path, tmp_path: Path) -> str:
    """What one process of this machine prints."""
    return sweep(spec, tmp_path / "local", "--workers", "1")[0]


@pytest.mark.parametrize("engine", ["ray", "dask"])
def test_an_engine_on_this_machine_makes_the_same_bytes(
    spec: Path, tmp_path: Path, expected: str, engine: str
) -> None:
    said, _ = sweep(spec, tmp_path / engine, "--on", engine)
    assert said == expected
    check_files(tmp_path / "local", tmp_path / engine)


def test_dask_takes_the_scheduler_that_is_named(spec: Path, tmp_path: Path, expected: str) -> None:
    address = "tcp://127.0.0.1:1"
    command = [
        str(PYTHON),
        "-m",
        "edgectl",
        "simulate",
        "sweep",
        str(spec),
        "--out",
        str(tmp_path / "x"),
        "--on",
        "dask",
    ]
    given = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "2s"}
    given["DASK_SCHEDULER_ADDRESS"] = address
    done = subprocess.run(
        command, env=given, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 1
    assert address in done.stderr
    assert "Traceback" not in done.stderr
    assert expected


def test_slurm_makes_the_same_bytes_and_resumes(
    spec: Path, tmp_path: Path, expected: str, slurm: dict[str, str]
) -> None:
    out = tmp_path / "shared"
    assert sweep(spec, out, "--on", "slurm", "--workers", "3", environment=slurm)[0] == expected
    check_files(tmp_path / "local", out)
    assert len(list(out.glob("slurm-*.log"))) == 3
    first = min(out.glob("*.json"))
    first.unlink()
    assert sweep(spec, out, "--on", "slurm", environment=slurm)[0] == expected
    assert len(list(out.glob("slurm-*.log"))) == 4


def check_files(one: Path, other: Path) -> None:
    files = sorted(path.name for path in one.glob("*.json"))
    assert len(files) == 4
    assert files == sorted(path.name for path in other.glob("*.json"))
    assert all((one / name).read_bytes() == (other / name).read_bytes() for name in files)
