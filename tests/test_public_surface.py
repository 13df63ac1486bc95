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
isd_gym.benchmark.cards
    also BUILT_IN CLOSE SAME built_in digest load make match ranking read_score track
isd_gym.benchmark.ceilings
    also Ceiling FEWEST FIGURES SEED SETTINGS bounds_beside ceiling fronts passive_cost reachable
isd_gym.benchmark.comparability
    also Comparable NAMES comparable
isd_gym.benchmark.driving
    Conditions Controller Entry cost_of
    also Crew Driver Idle rounded travel
isd_gym.benchmark.lq_bounds
    Best LQPoint best_acceleration lq_bound
    also CarBound Linear blind_gain ideal linear_car lq_front reference simulated_cost stationary
    wheelbase_bound
isd_gym.benchmark.policies
    Entry Idle available conventional find find_all passive
isd_gym.benchmark.scoring
    Conditions Controller Entry Idle LIMITS PAPER Run SCHEMA Score comfort_point drive frequency_weighting
    score weighted_rms
    also IDLE LEARN MEASURES PRINTED compare corner_measures idle_policies measures units unscored
isd_gym.benchmark.show
    also FPS SIZE WIDE film live snapshots
isd_gym.benchmark.sweep
isd_gym.benchmark.sweep.conditions
    also FOLDER RESAMPLES change_cell check_policies drive_item items_are merge overall rows sweep
isd_gym.benchmark.sweep.grid
    also BUILT_IN Condition Grid SCHEMA SENSES belongings built_in draw
isd_gym.benchmark.sweep.items
    also Answer ENGINES Item SCHEMA key_of run shard stored
isd_gym.benchmark.tracks
    TRACKS Track find_track
isd_gym.diagnosis
    CRITERIA Criteria Diagnosis Effect Evidence Gate Hypothesis LawSet Place Quantity SearchSettings Trace
    diagnose hypotheses
isd_gym.diagnosis.result
    Diagnosis Effect LawSet Place Quantity Trace
    also BestCandidate FOLDER Remainder SCHEMA ScreenedPlace Stretches
isd_gym.diagnosis.simulation
    FittedInitialState initial_state state_of
isd_gym.env
    ISDSuspensionEnv ISDSuspensionVectorEnv Options RELATIVE_SCALE Sensors
isd_gym.env.autoload
    also AT_START spec_of
isd_gym.env.history
    also BOUND History LEADS LEAKS Remembered SCALES history_of
isd_gym.env.registration
    also BY_CORNERS ENVIRONMENTS EPISODE_STEPS LEARNING REWARD_THRESHOLDS register
isd_gym.env.task
    also CONTROL_STEP EXCEEDS OBSERVATIONS Options PICTURE_WINDOW PREVIEW RELATIVE_SCALE ROAD_BOUND SCALES
    SHOWN STATE_BOUND Task USUAL_SPEED info_maker usual_level
isd_gym.physics
isd_gym.physics.car_prediction
    also CarModel CarWeights WholeCar car_model car_regulator columns continuous drifts
isd_gym.physics.cost
    FULL_CAR HALF_CAR QUARTER_CAR StageCost square
    also LARGEST MOTIONS Signal
isd_gym.physics.elements
    ActuatorDelay ActuatorLag AsymmetricDamping AsymmetricFriction Backlash BumpStop CoggingForce
    ConstantForce ControlledDamper CoulombFriction CubicStiffness DRIVE_ORDER DegressiveDamping DriveDeadZone
    Element GROUND GasSpring GravitySine Hysteresis Inertance LinearDamping LinearStiffness
    LoadDependentFriction MECHANISMS Motion Motor PROBE QuadraticDamping QuadraticThrust ScheduledDamping
    ScheduledFriction SensorBias SensorDeadZone SensorDelay SensorGain SensorMagnitude SeriesCompliance
    Setting Start StribeckFriction TYPES TabulatedForce TerminalInertia ThrustSaturation TyreLiftOff beside
    delayed discover parameter parameter_fields plausible register register_file rms spoken transmits
isd_gym.physics.fmu
    export_fmu
    also MEMORY NetworkSlave Running identifier
isd_gym.physics.network
    AXES Assembly Body Channel GROUND Lever MOTIONS Network Point SCHEMA StateSpace UNITS assemble
    assemble_all builtin_networks cut linearise natural_frequencies own_time rejoin slowest_time transfer
    without
isd_gym.physics.network.frames
    also complete frames order_told unknown
isd_gym.physics.prediction
    also DESIGN_SPEED Equations Laws Linearised Model N_SENSORS PAPER_CAR ROAD_INTENSITY SLIDING Sensors
    Weights device_reach dry equations equivalent_damping feedback held_over_step kalman_gain lift
    move_regulator of_currents paper_reach prediction_model preview_regulator regulator riccati stationary
    statistical_linearisation steady_gain weighted white_covariance
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
isd_gym.physics.vehicle
    also AXES CURRENT_LIMIT Corner GRAVITY ROAD SLEW_LIMIT SLEW_RATE Signal Vehicle kind require_quarter_car
    state_channels vehicle
isd_gym.records
isd_gym.records.data
    Finding Format Table check convert read_table write_table
isd_gym.records.inspection
    Inspection head inspect lines
isd_gym.records.inspection.facts
    also FEW Facts Oddity facts_of odd_scale odd_stamps odd_values quantity_of si_unit unit_in_name
isd_gym.records.inspection.map_file
    also map_content save_map
isd_gym.records.inspection.match
    also ALIKE CLEAR COLUMNS Candidate DOUBT DRIVES Drive EXACT FITS GIVEN LAG NOTHING PHYSICS SAMPLES
    Suggestion Window suggest
isd_gym.records.inspection.name_matching
    also alike channel_words tokens
isd_gym.records.inspection.report
    also Inspection LAST_STAMP head inspect lines percent_of
isd_gym.records.loggers
    ChannelMap Column Logger Raster Recording Signal files_of mended rasters runs
isd_gym.records.loggers.grid
    also inputs_of outputs_of
isd_gym.records.loggers.mapping
    also ChannelMap Column JOIN Logger SCHEMA files_of runs
isd_gym.records.loggers.record_reading
    also records_of
isd_gym.records.loggers.recording
    also EPOCH GAP LEAST Raster Recording Signal UNEVEN continuous even mended rasters rounded sampled spans
isd_gym.records.schemas
    load
    also NAMES check
isd_gym.sb3
    BatchedVecEnv ScoreCallback make_vec_env save_model
    also DEFAULT_ID VALIDATION_SEED
isd_gym.view
    score_report write_report
isd_gym.view.rendering
    BLUE CAR_COLOURS CarSnapshot CornerSnapshot GREEN ORANGE PULL PURPLE PUSH Renderer VERMILLION
    check_display write_video
isd_gym.view.rendering.backend
    also NO_WINDOW check_display extra pygame start_display
isd_gym.view.rendering.canvas
    also Anchor Canvas Point number
isd_gym.view.rendering.car
    also CARRIER CarScene FLOOR LARGEST_METRE SMALLEST_SUSPENSION TOP View
isd_gym.view.rendering.corner
    also CYLINDER LENGTH OIL_STROKE Suspension Words demands
isd_gym.view.rendering.curves
    also History SECONDS Scale plot
isd_gym.view.rendering.film
    also write_video
isd_gym.view.rendering.palette
    also BLUE CAR_COLOURS Colour GREEN GROUND GROUND_FAR GROUND_MARK INK MUTED OIL ORANGE PALE PURPLE SKY_LOW
    SKY_TOP STEEL STEEL_FAR VERMILLION WHITE mix
isd_gym.view.rendering.panel
    also CELL Panel
isd_gym.view.rendering.renderer
    also EXAGGERATION Renderer
isd_gym.view.rendering.road
    also MARKS Window ground reference_height rulers
isd_gym.view.rendering.snapshots
    also CarSnapshot CornerSnapshot PITCH ROLL TRAVEL Trace VERTICAL
isd_gym.view.rendering.symbols
    also arrow coil dashpot
isd_gym.view.rendering.wheel
    also METRES RADIUS RUBBER RUBBER_FAR SQUASH WIDTH carrier side_rim tyre
isd_gym.view.report
    check_report check_target score_report write_report
isd_gym.view.report.charts
    also Axis COLUMNS Chart Dots Item Line MOST_DOTS Marks Panel QUIET Rule Span Ticks decades draw log_ticks
    picture
isd_gym.view.report.diagnosis
    also AFTER BEFORE FIGURES MEASURED MOST_CHANNELS MOST_LOOPS PERIODS RELATIONS STAGES STRETCH Scale View
    WORST check_target draw_gap draw_law draw_loops draw_parameters draw_spectra draw_time learned
    write_report
isd_gym.view.report.forces
    also Curve GRID Law Loops Missing TAPER laws_of measured_loops missing_force
isd_gym.view.report.plots
    also COLOURS DPI LINES LOOKS Look MARKERS Picture STYLE THEMED as_picture caption channel_text density
    figure looks number page percent sentence style themed unit_text units_text versions
isd_gym.view.report.schematic
    Drawing check_suffix draw
    also BOX HALF LETTER LETTERS LINE MARGIN MOVES PAPER SMALL SYMBOL SYMBOLS TALL
isd_gym.view.report.score
    also COLUMNS SCORE_KIND SCORE_PARTS SIGNALS Shown WELCH check_report histories score_report spectra
    trade_off
isd_gym.view.report.steps
    also draw_steps force_axis law_axis law_force trend
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
    for node in ast.parse(
        Path(find_spec(module).origin).read_text(encoding="utf-8")
    ).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {t.id for t in targets if isinstance(t, ast.Name)}
    return {n for n in names if not n.startswith("_")} - {"TYPE_CHECKING"}


def listed(module):
    """Return the names in `__all__` of a module; tables of names (`[*_HOME]`) are read from the module."""
    for node in ast.parse(
        Path(find_spec(module).origin).read_text(encoding="utf-8")
    ).body:
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
            lines += textwrap.wrap(
                " ".join(names), 110, initial_indent="    ", subsequent_indent="    "
            )
    return "\n".join(lines)


def test_public_names_are_listed():
    assert surface() == SURFACE.strip()


@pytest.mark.parametrize("module", public_modules())
def test_names_of_all_exist(module):
    if module == "isd_gym.sb3":
        pytest.importorskip("stable_baselines3")
    assert not [
        n
        for n in listed(module)
        if n.startswith("_") or not hasattr(import_module(module), n)
    ]


if __name__ == "__main__":
    here = Path(__file__)
    text = here.read_text(encoding="utf-8")
    here.write_text(
        re.sub(
            r'(?<=SURFACE = """\n).*?(?=""")',
            lambda _: surface() + "\n",
            text,
            count=1,
            flags=re.DOTALL,
        ),
        encoding="utf-8",
    )
