"""The public names of the package are those of a list: what users import changes on purpose only.

A module is private if a part of its path begins with `_`. After a wanted change, ``python tests/test_public_surface.py`` writes the list.
"""

import ast
import pkgutil
import re
import textwrap
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import isd_gym

#: module, and the names in its `__all__`; after "also" names that modules of the package share
SURFACE = """
isd_gym
    Diagnosis ISDSuspensionEnv ISDSuspensionVectorEnv InputError MissingColumn Network ReportError Score
    StageCost Table TyreContactWarning diagnose linearise read_table score simulate
isd_gym.agents
isd_gym.agents.policy
    Policy
    also FEATURE_LIMIT Head SCHEMA SHIPPED read_safetensors
isd_gym.baselines
    BatchController CONTROLLERS PLANTS make
    also ABOUT WHOLE_CAR noisy
isd_gym.baselines.controller
    BatchController DesignedController clean limit rises steps_ahead
    also CURRENT Settings
isd_gym.baselines.friction
    FrictionMpcSettings
    also FrictionMpc with_preview
isd_gym.baselines.lqg
    LqgSettings
    also FullStateLqr LawSettings Lqg STEEPEST
isd_gym.baselines.mpc
    MpcSettings
    also ACCELERATION_LIMIT Mpc PAPER TRAVEL_LIMIT
isd_gym.benchmark
isd_gym.benchmark.driving
    Controller Entry cost_of
    also Crew Driver Idle travel
isd_gym.benchmark.lq_bounds
    Best LQPoint best_acceleration lq_bound
    also CarBound Linear blind_gain ideal ideal_car linear_car lq_front reference simulated_cost stationary
    wheelbase_bound
isd_gym.benchmark.policies
    Entry Idle available conventional find find_all passive
isd_gym.benchmark.scoring
    Controller Entry Idle LIMITS PAPER Run SCHEMA Score comfort_point drive frequency_weighting score
    weighted_rms
    also IDLE LEARN MEASURES PRINTED check_size compare corner_measures fingerprints idle_policies measures
    units unscored
isd_gym.benchmark.tracks
    TRACKS Track find_track
isd_gym.diagnosis
    CRITERIA Contender Criteria Diagnosis Effect EffectEvidence Evidence Gate Hypothesis Law Place Quantity
    SearchSettings Trace diagnose hypotheses
isd_gym.diagnosis.result
    Contender Diagnosis Effect Law Place Quantity Trace
    also BestCandidate BestTable FOLDER Over Remainder SCHEMA ScreenedPlace Stretches Tabulated
isd_gym.diagnosis.simulation
    FittedInitialState initial_state state_of
isd_gym.env
    ISDSuspensionEnv ISDSuspensionVectorEnv Options RELATIVE_SCALE Sensors
isd_gym.env.autoload
    also AT_START spec_of
isd_gym.env.registration
    also BY_CORNERS ENVIRONMENTS EPISODE_STEPS LEARNING REWARD_THRESHOLDS register
isd_gym.physics
isd_gym.physics.cost
    FULL_CAR HALF_CAR QUARTER_CAR StageCost square
    also LARGEST MOTIONS Signal
isd_gym.physics.elements
    ActuatorDelay ActuatorLag AsymmetricDamping AsymmetricFriction Backlash BumpStop CoggingForce
    ConstantForce ControlledDamper CoulombFriction CubicStiffness DRIVE_ORDER DegressiveDamping DriveDeadZone
    Element GROUND GasSpring GravitySine Hysteresis Inertance LinearDamping LinearStiffness
    LoadDependentFriction MECHANISMS Motion Motor PERIODS PROBE QuadraticDamping QuadraticThrust
    ScheduledDamping ScheduledFriction SensorBias SensorDeadZone SensorDelay SensorGain SensorMagnitude
    SeriesCompliance Setting Start StribeckFriction TYPES TabulatedForce TerminalInertia ThrustSaturation
    TyreLiftOff beside delayed discover parameter parameter_fields plausible register register_file rms spoken
    transmits
isd_gym.physics.fmu
    export_fmu
    also MEMORY NetworkSlave POWERS Running base_units identifier
isd_gym.physics.network
    AXES Assembly Body Channel GROUND Lever MOTIONS Network Point SCHEMA StateSpace UNITS assemble
    assemble_all builtin_networks cut linearise natural_frequencies own_time rejoin slowest_time transfer
    without
isd_gym.physics.road
    NAMES Road bump iso_road on_side paper_road pothole profiled recorded road sweep
    also ISO_CLASSES PAPER_KAPPA PRINTED_KAPPA REFERENCE_FREQUENCY STEEPEST
isd_gym.physics.simulate
    simulate
    also COARSE FINE Interpolation PARTS PHYSICS_STEP Plant discretise effective_current pace sense
    side_by_side upsample
isd_gym.physics.tracks
    WheelPositions delayed innovations track_filters
    also COHERENCE_POLES COHERENCE_WEIGHTS DIFFERENCE_STATES ONE_WHEEL SUM_STATES TRACK_STATES
isd_gym.records
isd_gym.records.data
    Finding Format Table check convert read_table write_table
isd_gym.records.schemas
    load
    also NAMES check
isd_gym.sb3
    BatchedVecEnv ScoreCallback make_vec_env save_model
    also DEFAULT_ID VALIDATION_SEED
isd_gym.view
    score_report write_report
"""


def public_modules(package=isd_gym.__name__, path=isd_gym.__path__):
    """Return the dotted names of the public modules, packages included."""
    found = [package]
    modules = [m.name for m in pkgutil.iter_modules(path)]
    if package == "isd_gym":
        modules += ["agents", "baselines"]  # folders of their own in a source tree
    for module in dict.fromkeys(modules):
        name = f"{package}.{module}"
        if module.startswith("_"):
            continue
        folder = find_spec(name).submodule_search_locations
        inside = public_modules(name, folder) if folder else [name]
        found += inside
    return sorted(found)


def defined(module):
    """Return the public names that the source of a module defines."""
    names = set()
    for node in ast.parse(Path(find_spec(module).origin).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {t.id for t in targets if isinstance(t, ast.Name)}
    return {n for n in names if not n.startswith("_")} - {"TYPE_CHECKING"}


def listed(module):
    """Return the names in `__all__` of a module; tables of names (`[*_HOME]`) are read from the module."""
    for node in ast.parse(Path(find_spec(module).origin).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            if all(isinstance(e, ast.Constant) for e in node.value.elts):
                return {e.value for e in node.value.elts}
            return set(import_module(module).__all__)
    return set()


def surface():
    """Return the list of all public names as text."""
    lines = []
    for module in public_modules():
        named = listed(module)
        others = sorted(defined(module) - named)
        lines.append(module)
        for names in (sorted(named), ["also", *others] if others else []):
            lines += textwrap.wrap(" ".join(names), 110, initial_indent="    ", subsequent_indent="    ")
    return "\n".join(lines)


def test_public_names_are_listed():
    assert surface() == SURFACE.strip()


@pytest.mark.parametrize("module", public_modules())
def test_names_of_all_exist(module):
    if module == "isd_gym.sb3":
        pytest.importorskip("stable_baselines3")
    assert not [n for n in listed(module) if n.startswith("_") or not hasattr(import_module(module), n)]


if __name__ == "__main__":
    here = Path(__file__)
    text = here.read_text(encoding="utf-8")
    here.write_text(
        re.sub(r'(?<=SURFACE = """\n).*?(?=""")', lambda _: surface() + "\n", text, count=1, flags=re.DOTALL),
        encoding="utf-8",
    )
