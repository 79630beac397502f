"""A body in the light: opened from roughly to finely, and given back."""

from dataclasses import replace

import pytest
from lit_body import SUN, lit_mesh, pose

from gpu.device import DeviceReport, first_kind
from gpu.errors import DeviceError
from service.inference.model.drawing import Quality, View
from service.workers import lit_body as lit
from service.workers.lit_body import LitBody


class Closings:
    """Counts what is opened and closed."""

    def __init__(self, monkeypatch, most: int = 99) -> None:
        self.opened, self.closed = 0, 0
        for name in ("open_shaded", "open_evidence"):
            monkeypatch.setattr(lit, name, self._counted(getattr(lit, name), most))

    def _counted(self, really, most: int):
        def open_one(*args, **kind):
            if self.opened == most:
                raise DeviceError("no more room")
            found = really(*args, **kind)
            self.opened += 1
            close = found.close

            def closing() -> None:
                self.closed += 1
                close()

            found.close = closing
            return found

        return open_one


def test_a_body_opens_from_roughly_to_finely_and_closes(monkeypatch):
    counted = Closings(monkeypatch)
    mesh, articulation = lit_mesh()
    opened = LitBody(mesh, articulation)
    try:
        drawings = (opened.body.rough, opened.body.middle, opened.body.fine)
        assert [one.n_groups for one in drawings] == sorted(one.n_groups for one in drawings)
        assert all(one.radius == mesh.radius and one.articulation is articulation for one in drawings)
        totals = []
        for one in drawings:
            planes = one.planes(pose(), SUN, View((100.0, 60.0), 1.0, 64), Quality(3, 128))
            assert planes.shape[1] == one.n_planes(Quality(3, 128)) == one.n_groups + 4 + 3  # of three pieces
            totals.append(float(planes[:, : one.n_groups].sum()))
        assert totals == pytest.approx([totals[-1]] * 3, rel=0.05)
    finally:
        opened.close()
    assert counted.opened == counted.closed == 4
    opened.close()
    assert counted.closed == 4


def test_other_joints_are_free_on_the_same_drawings():
    mesh, articulation = lit_mesh()
    opened = LitBody(mesh, articulation)
    try:
        held = replace(articulation, joints=())
        body = opened.articulated(held)
        assert body.rough.articulation is body.middle.articulation is body.fine.articulation is held
        assert body.fine.shaded is opened.body.fine.shaded and body.fine.light is opened.body.fine.light
        assert opened.body.fine.articulation is articulation
    finally:
        opened.close()


def test_light_is_computed_on_a_cpu_and_on_a_gpu_where_opencl_has_no_cpu(monkeypatch):
    cpu, gpu, broken = (
        DeviceReport("P", "D", "OpenCL 3", kind, why, (0, 0))
        for kind, why in (("cpu", None), ("gpu", None), ("cpu", "the probe kernel failed"))
    )
    kinds = [first_kind("cpu", "gpu", reports=found) for found in ([gpu, cpu], [gpu, broken], [broken], [])]
    assert kinds == ["cpu", "gpu", "cpu", "cpu"]
    asked = []
    monkeypatch.setattr(lit, "first_kind", lambda *wanted: asked.append(wanted) or "other")
    with pytest.raises(DeviceError, match="no OTHER is an OpenCL device"):
        LitBody(*lit_mesh())
    assert asked == [("cpu", "gpu")]


@pytest.mark.parametrize("most", range(4))
def test_what_is_open_is_given_back_where_opening_fails(monkeypatch, most):
    counted = Closings(monkeypatch, most)
    with pytest.raises(DeviceError):
        LitBody(*lit_mesh())
    assert counted.opened == counted.closed == most
