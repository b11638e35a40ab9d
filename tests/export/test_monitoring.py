# SPDX-License-Identifier: Apache-2.0
"""docs/monitoring: alert rules and dashboard, judged by promtool and compared with what edgectl exports."""

import json
import re
import shutil
from pathlib import Path

import yaml

from edgectl.export.metrics import METRICS
from tests.export.test_metrics import run_promtool
from tests.views.fixtures import ROOT

FOLDER = ROOT / "docs" / "monitoring"
RULES = yaml.safe_load((FOLDER / "edgectl.rules.yml").read_text())["groups"][0]["rules"]
PANELS = json.loads((FOLDER / "grafana-dashboard.json").read_text())["panels"]
# Seconds from the start of the played series, alert -> when it must not fire yet, and when it must.
STORY = {
    "HostDown": ('edgectl_host_up{host="zeta",role="edge"}', "1 1 0x20", 3, 6),
    "TaskFailed": ('edgectl_task_state{task="slam",state="crashloop"}', "0 0 0 1x20", 2, 4),
    "TaskUnplaced": ('edgectl_task_unplaced{task="slam"}', "0 1x20", 5, 7),
    "TaskMovesTooOften": ('edgectl_task_moves_total{task="slam"}', "0 0 0+1x60", 2, 20),
    "HostFull": ('edgectl_host_memory_used_bytes{host="zeta"}', "10 99x30", 4, 8),
    "LinkFull": ('edgectl_link_used_bytes_per_second{edge="zeta",robot="r"}', "10 99x30", 4, 8),
    "EdgectlSilent": ("edgectl_last_probe_timestamp_seconds", "0x60", 9, 12),
}
WHOLE = [
    'edgectl_host_memory_bytes{host="zeta"}',
    'edgectl_link_capacity_bytes_per_second{edge="zeta",robot="r"}',
]


def list_queries() -> list[str]:
    return [
        *(rule["expr"] for rule in RULES),
        *(target["expr"] for panel in PANELS for target in panel["targets"]),
    ]


def test_promtool_takes_configuration_and_rules() -> None:
    code, said = run_promtool("check", "config", str(FOLDER / "prometheus.yml"))
    assert (code, f"{len(RULES)} rules found" in said) == (0, True), said


def test_each_alert_fires_when_it_should_and_not_before(tmp_path: Path) -> None:
    """promtool plays each story, minute by minute, against the rules."""
    assert STORY.keys() == {rule["alert"] for rule in RULES}
    shutil.copy(FOLDER / "edgectl.rules.yml", tmp_path)
    for number, (name, (series, values, quiet, loud)) in enumerate(STORY.items()):
        played = [
            {"series": series, "values": values},
            *({"series": each, "values": "100x60"} for each in WHOLE),
        ]
        queries = [
            {"expr": f'count(ALERTS{{alertname="{name}",alertstate="firing"}}) or vector(0)', "eval_time": f"{minute}m",
             "exp_samples": [{"labels": "{}", "value": wanted}]}
            for minute, wanted in ((quiet, 0), (loud, 1))
        ]  # fmt: skip
        story = {"rule_files": ["edgectl.rules.yml"], "evaluation_interval": "1m",
                 "tests": [{"interval": "1m", "input_series": played, "promql_expr_test": queries}]}  # fmt: skip
        (tmp_path / f"{number}.yml").write_text(yaml.safe_dump(story))
    code, said = run_promtool(
        "test", "rules", *(str(tmp_path / f"{number}.yml") for number in range(len(STORY)))
    )
    assert code == 0, said


def test_every_query_is_promql_and_names_what_is_exported(tmp_path: Path) -> None:
    known = {metric.name: set(metric.labels) for metric in METRICS}
    for query in list_queries():
        names = re.findall(r"edgectl_\w+", query)
        assert names, query
        labels = set()
        for name in names:
            base = name.removesuffix("_bucket")
            assert base in known, query
            labels |= known[base] | ({"le"} if base != name else set())
        used = re.findall(r"(\w+)=~?\"", query) + [
            word
            for group in re.findall(r"(?:by|on) \(([^)]*)\)", query)
            for word in re.findall(r"\w+", group)
        ]
        assert set(used) <= labels, query
    rules = [{"record": f"q{number}", "expr": query} for number, query in enumerate(list_queries())]
    (tmp_path / "queries.yml").write_text(yaml.safe_dump({"groups": [{"name": "queries", "rules": rules}]}))
    code, said = run_promtool("check", "rules", str(tmp_path / "queries.yml"))
    assert code == 0, said


def test_legends_of_the_dashboard_name_labels() -> None:
    known = {metric.name: set(metric.labels) for metric in METRICS}
    for panel in PANELS:
        for target in panel["targets"]:
            of_all = set().union(
                *(known[name.removesuffix("_bucket")] for name in re.findall(r"edgectl_\w+", target["expr"]))
            )
            assert set(re.findall(r"{{(\w+)}}", target["legendFormat"])) <= of_all, panel["title"]
    places = [(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in PANELS]
    assert len(set(places)) == len(PANELS)
    assert [panel["title"] for panel in PANELS if panel["gridPos"]["x"] + panel["gridPos"]["w"] > 24] == []
