"""FMUs as estimators: one made by PythonFMU (FMI 2.0), one compiled from C (FMI 3.0), both against the batch."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ahrs_sim import cli, plugins
from ahrs_sim.errors import InputError
from ahrs_sim.plugins.library import FmuEstimator
from estimators import Samples, SensorInfo, Site, Status

pytest.importorskip("fmpy")
from fmpy.fmi3 import FMU3Slave

SITE, SENSORS = Site((0.76, 0.026, 150.0)), SensorInfo()

PYTHON_UNIT = """
import math
from pythonfmu import Fmi2Slave, Fmi2Causality, Fmi2Variability, Real, Boolean

class Gyro(Fmi2Slave):
    '''Integrates one axis of the gyro: heading = sum of rates times dt.'''
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.gain, self.spin, self.fresh = 1.0, 0.0, False
        self.roll = self.pitch = self.heading = 0.0
        self.register_variable(Real("gain", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("spin", causality=Fmi2Causality.input))
        self.register_variable(Boolean("fresh", causality=Fmi2Causality.input))
        for name in ("roll", "pitch", "heading"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))
    def do_step(self, t, dt):
        self.heading += self.gain * self.spin * dt
        self.roll = 0.25 if self.fresh else 0.0
        return True
"""

C_UNIT = r"""
#include <stdlib.h>
#include <string.h>
#define API __attribute__((visibility("default")))
typedef struct { double gyro[3], q[4], t; } Unit;
enum { GYRO, Q };
API const char *fmi3GetVersion(void) { return "3.0"; }
API int fmi3SetDebugLogging(void *u, _Bool on, size_t n, const char *const c[]) { return 0; }
API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *path, _Bool visible, _Bool log,
    _Bool events, _Bool early, const unsigned required[], size_t n, void *env, void *logger, void *update) {
    Unit *u = calloc(1, sizeof *u); u->q[0] = 1.0; return u; }
API void fmi3FreeInstance(void *u) { free(u); }
API int fmi3EnterInitializationMode(void *u, _Bool tol, double x, double start, _Bool stop, double y) { return 0; }
API int fmi3ExitInitializationMode(void *u) { return 0; }
API int fmi3Terminate(void *u) { return 0; }
API int fmi3Reset(void *u) { return 0; }
API int fmi3SetFloat64(void *p, const unsigned r[], size_t n, const double v[], size_t m) {
    memcpy(((Unit *)p)->gyro, v, sizeof ((Unit *)p)->gyro); return 0; }
API int fmi3GetFloat64(void *p, const unsigned r[], size_t n, double v[], size_t m) {
    memcpy(v, ((Unit *)p)->q, sizeof ((Unit *)p)->q); return 0; }
API int fmi3DoStep(void *p, double t, double dt, _Bool no, _Bool *event, _Bool *end, _Bool *early, double *last) {
    Unit *u = p; %s
    double a = u->q[0], b = u->q[1], c = u->q[2], d = u->q[3];
    double x = 0.5 * dt * u->gyro[0], y = 0.5 * dt * u->gyro[1], z = 0.5 * dt * u->gyro[2];
    u->q[0] = a - b*x - c*y - d*z; u->q[1] = b + a*x + c*z - d*y;
    u->q[2] = c + a*y + d*x - b*z; u->q[3] = d + a*z + b*y - c*x;
    *event = *end = *early = 0; *last = t + dt; return 0; }
"""
C_DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="unit" instantiationToken="{{1}}">
  <CoSimulation modelIdentifier="unit"/>
  <ModelVariables>
    <Float64 name="time" valueReference="9" causality="independent" variability="continuous"/>
    <Float64 name="gyro_b" valueReference="0" causality="input" variability="discrete" start="0 0 0">
      <Dimension start="3"/></Float64>
    <Float64 name="q_nb" valueReference="1" causality="output" variability="discrete"><Dimension start="4"/></Float64>
  </ModelVariables>
  <ModelStructure><Output valueReference="1"/></ModelStructure>
</fmiModelDescription>
"""


def samples(n: int = 500) -> Samples:
    rng = np.random.default_rng(3)
    t = 5.0 + np.arange(n) * 0.01
    return Samples.make(t, rng.normal(0, 0.02, (n, 3)), rng.normal(0, 1, (n, 3)), mag_new=np.arange(n) % 2 == 0)


@pytest.fixture(scope="module")
def python_unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pythonfmu")
    folder = tmp_path_factory.mktemp("fmu")
    (folder / "gyro.py").write_text(PYTHON_UNIT)
    subprocess.run([sys.executable, "-m", "pythonfmu", "build", "-f", "gyro.py"], cwd=folder, check=True)
    return folder / "Gyro.fmu"


def c_unit(folder: Path, fault: str = "", description: str = C_DESCRIPTION) -> Path:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    names = {name for name in dir(FMU3Slave) if name.startswith("fmi3")}
    stubs = [f"API int {name}(void) {{ return 3; }}" for name in sorted(names) if f" {name}(" not in C_UNIT]
    stubs = [
        s for s in stubs if f"*{s.split('(')[0].split()[-1]}(" not in C_UNIT
    ]  # the functions that a unit must export
    (folder / "unit.c").write_text(C_UNIT % fault + "\n".join(stubs))
    subprocess.run(["cc", "-w", "-O1", "-shared", "-fPIC", "-o", "unit.so", "unit.c"], cwd=folder, check=True)
    import platform

    machine = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    with zipfile.ZipFile(folder / "unit.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(folder / "unit.so", f"binaries/{machine}-linux/unit.so")
    return folder / "unit.fmu"


def test_one_made_by_pythonfmu(python_unit: Path) -> None:
    given = samples()
    names = {"gyro_z": "spin", "mag_new": "fresh"}
    made = FmuEstimator(python_unit, site=SITE, sensors=SENSORS, gain=2.0, map=names)
    found = made.process(given)
    made.close()
    dt = np.diff(given.t, prepend=given.t[0] - 0.01)
    heading = 2.0 * np.cumsum(given.gyro_b[:, 2] * dt)
    roll = np.where(given.mag_new, 0.25, 0.0)
    np.testing.assert_allclose(found.down_b[:, 1], np.sin(roll), atol=1e-12)
    q = found.q_nb
    np.testing.assert_allclose(
        np.arctan2(2 * (q[:, 0] * q[:, 3] + q[:, 1] * q[:, 2]), 1 - 2 * (q[:, 2] ** 2 + q[:, 3] ** 2)),
        heading,
        atol=1e-9,
    )
    assert (found.status == Status.RUNNING).all()


def test_one_compiled_from_c(tmp_path: Path) -> None:
    given = samples()
    made = FmuEstimator(c_unit(tmp_path), site=SITE, sensors=SENSORS)
    whole = made.process(given).q_nb
    made.reset()
    parts = np.concatenate([made.process(given[i : i + 77]).q_nb for i in range(0, len(given), 77)])
    made.close()
    np.testing.assert_array_equal(whole, parts)
    expected, q = np.empty((len(given), 4)), np.array([1.0, 0.0, 0.0, 0.0])
    for k, (w, dt) in enumerate(zip(given.gyro_b, np.diff(given.t, prepend=given.t[0] - 0.01), strict=True)):
        a, b, c, d = q
        x, y, z = 0.5 * dt * w
        turn = [
            a - b * x - c * y - d * z,
            b + a * x + c * z - d * y,
            c + a * y + d * x - b * z,
            d + a * z + b * y - c * x,
        ]
        q = expected[k] = np.array(turn)
    np.testing.assert_allclose(whole, expected, rtol=0, atol=1e-12)


def test_it_flies_and_a_crash_ends_it_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    c_unit(tmp_path, "if (t > 5.0) abort();")
    command = ["fly", "takeoff", "--duration", "9", "--estimator", "fmu:unit.fmu@chr", "--estimator", "ekf-chr"]
    assert cli.main([*command, "-o", "x.mcap"]) == 1
    printed = capsys.readouterr()
    assert "estimator 'unit-chr' crashed (SIGABRT)" in printed.err and "ekf-chr" in printed.out


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("CoSimulation", "ModelExchange"), "model-exchange kind"),
        (('name="gyro_b"', 'name="thrust"'), "inputs that nobody fills: thrust"),
        (('name="q_nb"', 'name="answer"'), "no output q_w"),
    ],
)
def test_one_that_cannot_be_used_is_one_line(tmp_path: Path, change: tuple[str, str], reason: str) -> None:
    unit = c_unit(tmp_path, description=C_DESCRIPTION.replace(*change))
    with pytest.raises(InputError, match=reason) as caught:
        FmuEstimator(unit, site=SITE, sensors=SENSORS)
    assert "\n" not in str(caught.value)


def test_other_mistakes_are_one_line_too(tmp_path: Path) -> None:
    unit = c_unit(tmp_path)
    with pytest.raises(InputError, match="no parameter 'gian'"):
        FmuEstimator(unit, site=SITE, sensors=SENSORS, gian=1.0)
    with pytest.raises(InputError, match="no variable 'nothing'"):
        FmuEstimator(unit, site=SITE, sensors=SENSORS, map={"mag_x": "nothing"})
    (tmp_path / "text.fmu").write_text("no archive")
    with pytest.raises(InputError, match="is no FMU"):
        FmuEstimator(tmp_path / "text.fmu", site=SITE, sensors=SENSORS)
    with zipfile.ZipFile(unit) as given, zipfile.ZipFile(tmp_path / "windows.fmu", "w") as made:
        made.writestr("modelDescription.xml", given.read("modelDescription.xml"))
        made.writestr("binaries/win64/unit.dll", b"")
    with pytest.raises(InputError, match=r"has code for win64, not for linux64; export it for that$"):
        FmuEstimator(tmp_path / "windows.fmu", site=SITE, sensors=SENSORS)
    with pytest.raises(InputError, match="no such file"):
        plugins.located("none.fmu", tmp_path)
