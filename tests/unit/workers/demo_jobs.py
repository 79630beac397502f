"""A few frames of the bundled satellite, as jobs for a tracker."""

from gpu.mesh import load_mesh
from service.inference.params import FilterParams, JointParams, SessionConfig
from service.simulate.folder import encode_png
from service.simulate.motion import Motion
from service.simulate.satellite import demo_satellite
from service.simulate.scenario import Scenario
from service.simulate.sequence import SimulatedPass
from service.workers.base import BackgroundJob, FrameJob, ModelJob
from service.workers.tracker import Tracker, content_key

FRAMES = 3
SIZE = (64, 64)


class DemoPass:
    """A few frames of the bundled satellite, as jobs."""

    def __init__(self) -> None:
        tracker = Tracker()
        self.report = tracker.prepare_model(ModelJob(demo_satellite(), "glb"))
        scenario = Scenario("", size=SIZE, seed=4, motion=Motion(frames=FRAMES))
        simulated = SimulatedPass(load_mesh(demo_satellite(), "glb"), self.report.articulation, scenario)
        learned = None
        for image in simulated.backgrounds():
            learned = tracker.learn_background(BackgroundJob(SessionConfig(), encode_png(image), "image/png", learned))
            learned = learned.background
        tracker.close()
        self.blobs = {content_key(data): data for data in (demo_satellite(), learned)}
        self.frames = [encode_png(image) for image in simulated.frames()]

    def job(self, backend, index=0, state=None, **choices):
        choices = {"particles": 100, "method": "bootstrap", **choices}
        config = SessionConfig(FilterParams(backend=backend, **choices), joints=JointParams(free="all"))
        model, background = self.blobs
        where = config, model, "glb", self.report.articulation, background, state, index, 0.1 * index
        return FrameJob(*where, self.frames[index], "image/png", self.blobs, self.report.twins)

    def model_of(self):
        """The model's key, its kind, and the files."""
        return next(iter(self.blobs)), "glb", self.blobs

    def track(self, tracker, backend, **choices):
        """The last frame's report, and who scored."""
        report, names = None, set()
        for index in range(FRAMES):
            state = None if report is None else report.state
            report = tracker.track(self.job(backend, index, state, **choices))
            names.add(report.scorer)
        return report, names
