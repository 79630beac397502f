"""Dashboard and alerts ask for metrics and labels that the service has."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from service.errors import every_error
from service.metrics import Metrics

OTHERS = {"up"}  # Prometheus's own
FUNCTIONS = {
    "absent",
    "by",
    "histogram_quantile",
    "increase",
    "max",
    "max_over_time",
    "rate",
    "sum",
}


def exposed() -> dict[str, set[str]]:
    """Name of every series of ``/metrics`` -> its labels."""
    found: dict[str, set[str]] = {}
    for metric in vars(Metrics()).values():
        for family in getattr(metric, "describe", list)():
            labels = set(metric._labelnames)
            suffixes = {"counter": ["_total"], "gauge": [""], "histogram": ["_bucket", "_sum", "_count"]}[family.type]
            for suffix in suffixes:
                found[family.name + suffix] = labels | ({"le"} if suffix == "_bucket" else set())
    return found


def expressions(root: Path) -> list[str]:
    folder = root / "deploy" / "cluster"
    dashboard = json.loads((folder / "grafana" / "skypose.json").read_text())
    alerts = yaml.safe_load((folder / "alerts.yml").read_text())
    found = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    return [*found, *(rule["expr"] for group in alerts["groups"] for rule in group["rules"])]


def test_every_metric_exists_with_its_labels(root):
    have = exposed()
    asked = expressions(root)
    assert len(asked) > 25
    for expression in asked:
        bare = re.sub(r'"[^"]*"|\[[^\]]*\]', "", expression)
        names = set(re.findall(r"[a-z_]{2,}", bare)) & (set(have) | OTHERS)
        assert names, expression
        labels = set().union(*(have.get(name, {"job"}) for name in names)) | {"instance", "job"}
        words = set(re.findall(r"\b[a-z_]{2,}\b", bare)) - FUNCTIONS
        assert words <= names | labels, f"{words - names - labels} in {expression}"


def test_label_values_are_ones_that_the_service_gives(root):
    text = " ".join(expressions(root))
    types = set("|".join(re.findall(r'type=~"([^"]+)"', text)).split("|"))
    assert types <= {kind.slug for kind in every_error()}
    stages = set("|".join(re.findall(r'stage=~?"([^"]+)"', text)).split("|"))
    assert stages <= {"wait", "decode", "measure", "score", "total", "commit"}
    assert set(re.findall(r'\{status="([^"]+)"', text)) <= {"acquiring", "tracking", "lost", "no_target", "503"}


def test_panels_have_places_of_their_own_and_the_provisioned_source(root):
    folder = root / "deploy" / "cluster" / "grafana"
    source = yaml.safe_load((folder / "datasources.yaml").read_text())["datasources"][0]
    panels = json.loads((folder / "skypose.json").read_text())["panels"]
    places = set()
    for panel in panels:
        assert {target["datasource"]["uid"] for target in panel["targets"]} == {source["uid"]}
        at = panel["gridPos"]
        cells = {(x, y) for x in range(at["x"], at["x"] + at["w"]) for y in range(at["y"], at["y"] + at["h"])}
        assert max(x for x, _ in cells) < 24
        assert not cells & places, panel["title"]
        places |= cells
    assert len({panel["id"] for panel in panels}) == len(panels)


def test_alerts_are_explained(root):
    alerts = yaml.safe_load((root / "deploy" / "cluster" / "alerts.yml").read_text())
    page = (root / "docs" / "operations.md").read_text()
    for rule in alerts["groups"][0]["rules"]:
        assert f"`{rule['alert']}`" in page


def test_prometheus_takes_its_files(root):
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("promtool (Debian: prometheus) is not installed")
    folder = root / "deploy" / "cluster"
    for words in (
        ["rules", str(folder / "alerts.yml")],
        ["config", "--syntax-only", str(folder / "prometheus.yml")],
    ):
        checked = subprocess.run([promtool, "check", *words], capture_output=True, text=True, timeout=60)
        assert checked.returncode == 0, checked.stdout + checked.stderr
