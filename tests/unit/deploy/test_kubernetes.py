"""The Kubernetes files: valid by Kubernetes' schemas, built by kustomize where it is, and safe by what they say."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

VERSIONS = ("1.30", "1.34")
BUILT = ["base", "overlays/nvidia", "overlays/sqlite", "overlays/ray"]
FOREIGN = {"Kustomization", "ServiceMonitor"}  # their schemas are elsewhere


def documents(path: Path) -> list[dict[str, Any]]:
    return [document for document in yaml.safe_load_all(path.read_text()) if document]


def files(root: Path) -> list[Path]:
    return sorted((root / "deploy" / "kubernetes").rglob("*.yaml"))


def validate(document: dict[str, Any]) -> None:
    kubernetes_validate = pytest.importorskip("kubernetes_validate")
    if document["kind"] == "RayCluster":  # its own schema is its operator's, but its pods are Kubernetes'
        for group in (document["spec"]["headGroupSpec"], *document["spec"]["workerGroupSpecs"]):
            pod = {"apiVersion": "v1", "kind": "Pod", **group["template"]}
            validate({**pod, "metadata": {"name": "ray", **pod["metadata"]}})
        return
    for version in VERSIONS:
        kubernetes_validate.validate(document, version, strict=True)


def built(root: Path, name: str) -> list[dict[str, Any]]:
    """What kustomize makes of a folder."""
    folder = str(root / "deploy" / "kubernetes" / name)
    for command in (["kustomize", "build", folder], ["kubectl", "kustomize", folder]):
        if shutil.which(command[0]):
            made = subprocess.run(command, capture_output=True, text=True, timeout=60)
            assert made.returncode == 0, made.stderr
            return [document for document in yaml.safe_load_all(made.stdout) if document]
    pytest.skip("neither kustomize nor kubectl is installed")


def test_every_file_is_valid(root):
    patches = {"gpu.yaml", "single.yaml", "web.yaml"}  # parts of a whole: checked when built
    for path in files(root):
        for document in documents(path):
            if document["kind"] not in FOREIGN and path.name not in patches:
                validate(document)


def test_every_file_is_used_or_an_example(root):
    folder = root / "deploy" / "kubernetes"
    used = {path for path in files(root) if path.name == "kustomization.yaml" or path.parent == folder / "examples"}
    for path in list(used):
        if path.name == "kustomization.yaml":
            (found,) = documents(path)
            names = [*found["resources"], *(patch["path"] for patch in found.get("patches", []))]
            used |= {(path.parent / name).resolve() for name in names}
    assert set(files(root)) <= used


@pytest.mark.parametrize("name", BUILT)
def test_what_is_built_is_valid(root, name):
    found = built(root, name)
    for document in found:
        validate(document)
    assert {document["metadata"]["namespace"] for document in found} == {"skypose"}
    labels = {document["kind"]: document for document in reversed(found)}  # of two policies the first: the web's
    pods = labels["Deployment"]["spec"]["template"]["metadata"]["labels"].items()
    for selector in (
        labels["Service"]["spec"]["selector"],
        labels["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"],
        labels["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"],
        labels["Deployment"]["spec"]["selector"]["matchLabels"],
    ):
        assert selector.items() <= pods


def test_what_the_overlays_change(root):
    gpu = deployment(built(root, "overlays/nvidia"))
    assert container(gpu)["resources"]["limits"]["nvidia.com/gpu"] == 1
    assert container(gpu)["image"] == "skypose:nvidia"
    single = deployment(built(root, "overlays/sqlite"))
    assert single["spec"]["replicas"] == 1
    assert single["spec"]["strategy"] == {"type": "Recreate"}
    assert "SKYPOSE_DATABASE_URL" not in {entry["name"] for entry in container(single)["env"]}
    volumes = {volume["name"]: volume for volume in single["spec"]["template"]["spec"]["volumes"]}
    assert volumes["data"] == {"name": "data", "persistentVolumeClaim": {"claimName": "skypose-data"}}


def test_a_ray_cluster_runs_the_locked_ray_in_hardened_pods(root):
    found = built(root, "overlays/ray")
    cluster = next(document for document in found if document["kind"] == "RayCluster")
    assert f"ray=={cluster['spec']['rayVersion']} " in (root / "requirements-ray.lock").read_text()
    for group in (cluster["spec"]["headGroupSpec"], *cluster["spec"]["workerGroupSpecs"]):
        pod = group["template"]["spec"]
        assert pod["securityContext"]["runAsNonRoot"] is True
        assert pod["containers"][0]["securityContext"] == container(deployment(found))["securityContext"]
        assert group["template"]["metadata"]["labels"]["app.kubernetes.io/part-of"] == "skypose"
    assert pod["containers"][0]["resources"]["limits"]["nvidia.com/gpu"] == 1
    assert pod["containers"][0]["image"] == "skypose:ray-nvidia"
    command = container(deployment(found))["command"][-1]
    assert command.count(f"{cluster['metadata']['name']}-head-svc:6379") == 2


def test_pods_are_hardened_and_probed(root):
    web = deployment(documents(root / "deploy" / "kubernetes" / "base" / "deployment.yaml"))
    pod = web["spec"]["template"]["spec"]
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert pod["automountServiceAccountToken"] is False
    assert pod["enableServiceLinks"] is False
    assert container(web)["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    probes = {name: container(web)[f"{name}Probe"]["httpGet"]["path"] for name in ("startup", "readiness", "liveness")}
    assert probes == {"startup": "/readyz", "readiness": "/readyz", "liveness": "/healthz"}


def test_pods_write_where_the_image_does_and_run_as_its_user(root):
    text = (root / "Dockerfile").read_text()
    web = deployment(documents(root / "deploy" / "kubernetes" / "base" / "deployment.yaml"))
    assert f"--uid {web['spec']['template']['spec']['securityContext']['runAsUser']} " in text
    places = {mount["mountPath"] for mount in container(web)["volumeMounts"] if not mount.get("readOnly")}
    assert places == {"/data", "/var/cache/skypose", "/tmp"}
    assert 'VOLUME ["/data", "/var/cache/skypose"]' in text


def deployment(found: list[dict[str, Any]]) -> dict[str, Any]:
    return next(document for document in found if document["kind"] == "Deployment")


def container(found: dict[str, Any]) -> dict[str, Any]:
    only: dict[str, Any] = found["spec"]["template"]["spec"]["containers"][0]
    return only
