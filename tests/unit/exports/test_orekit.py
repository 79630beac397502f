"""An AEM and an ACM through Orekit, the flight dynamics library in Java, in a process of its own."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from golden import RATES, ROTATIONS, history

from service.exports.acm import write_acm
from service.exports.ccsds import write_aem

READ = """
import json, sys
import orekit_jpype
orekit_jpype.initVM()
from java.io import File
from org.orekit.data import DataContext, DataSource, DirectoryCrawler
from org.orekit.files.ccsds.ndm import ParserBuilder

DataContext.getDefault().getDataProvidersManager().addProvider(DirectoryCrawler(File(sys.argv[1])))
message = ParserBuilder().buildAemParser().parseMessage(DataSource(File(sys.argv[1] + "/pass.aem")))
rows = []
for segment in message.getSegments():
    for one in segment.getData().getAngularCoordinates():
        rotation, rate = one.getRotation(), one.getRotationRate()
        elements = [rotation.getQ0(), rotation.getQ1(), rotation.getQ2(), rotation.getQ3()]
        rows.append([elements, [rate.getX(), rate.getY(), rate.getZ()]])
comprehensive = ParserBuilder().buildAcmParser().parseMessage(DataSource(File(sys.argv[1] + "/pass.acm")))
data = comprehensive.getData()
zero = comprehensive.getMetadata().getEpochT0()
attitudes = [
    [float(one.getDate().durationFrom(zero)), [float(value) for value in one.getElements()]]
    for block in data.getAttitudeBlocks()
    for one in block.getAttitudeStates()
]
variances = [
    [float(one.getDate().durationFrom(zero)), [float(one.getMatrix().getEntry(k, k)) for k in range(3)]]
    for block in data.getCovarianceBlocks()
    for one in block.getCovariances()
]
print(json.dumps([rows, attitudes, variances]))
"""
LEAP_SECONDS = " 1972  Jan.  1 - 2017  Jan.  1    36s\n 2017  Jan.  1 -                  37s\n"


@pytest.mark.skipif(
    find_spec("orekit_jpype") is None or shutil.which("java") is None, reason="no Orekit (orekit-jpype) or no Java"
)
def test_orekit_reads_every_rotation_rate_and_variance(tmp_path):
    one = history()
    told = [tuple(replace(s, sigma_deg=np.array([0.1, 0.2, 0.3])) for s in segment) for segment in one.segments]
    one = replace(one, segments=tuple(told))
    text = write_aem(one)
    (tmp_path / "pass.acm").write_text(write_acm(one))
    # With its centre Orekit asks for the planets' ephemerides, which an attitude does not need.
    (tmp_path / "pass.aem").write_text(text.replace("CENTER_NAME = EARTH\n", ""))
    (tmp_path / "UTC-TAI.history").write_text(LEAP_SECONDS)
    read = [sys.executable, "-c", READ, str(tmp_path)]
    done = subprocess.run(read, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    rows, attitudes, variances = json.loads(done.stdout.splitlines()[-1])
    assert len(rows) == len(ROTATIONS)
    for k, (quaternion, rate) in enumerate(rows):
        np.testing.assert_allclose(quaternion, ROTATIONS[k][0], atol=1e-9)
        np.testing.assert_allclose(np.rad2deg(rate), RATES[k], atol=1e-9)
    assert [seconds for seconds, _ in attitudes] == [seconds for seconds, _ in variances] == list(range(len(rows)))
    for k, (_, (x, y, z, w, *rate)) in enumerate(attitudes):
        np.testing.assert_allclose([w, x, y, z], ROTATIONS[k][0], atol=1e-9)
        np.testing.assert_allclose(np.rad2deg(rate), RATES[k], atol=1e-9)
    for _, elements in variances:
        np.testing.assert_allclose(np.rad2deg(np.sqrt(elements)), [0.1, 0.2, 0.3], rtol=1e-6)
