"""Settings that steer the search: what the search does not try cannot be found, but the settings decide nothing else."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How far the search goes. The settings are an argument of `diagnose` and are returned with the result."""

    #: hypotheses that are fitted to the window of the records with the widest gap
    first_round: int = 8
    #: hypotheses of the first round that are fitted to whole records
    finals: int = 4
    #: physics steps of a simulation of all windows up to which more hypotheses enter the first round
    cheap_steps: int = 200_000
    #: gap (power of the error over the power of the signal) above which the score test, which is local, says too little
    wide_gap: float = 0.1
    #: hypotheses that enter the first round above that gap because they come nearest to the records at large amplitudes
    nearest: int = 4
    #: multiples of the score test's amplitude from which fits start: the test is local, and a large effect is found by trying
    amplitudes: tuple[float, ...] = (0.5, 1.0, 2.0, 5.0, 12.0, 30.0)
    #: further multiples for laws whose parameter falls with the force, such as a compliance, and where the phase is lost
    large: tuple[float, ...] = (80.0,)
    #: further multiples where the sign is open
    other_sign: tuple[float, ...] = (-2.0, -12.0, -80.0)
    #: multiples of the parameter that shapes a law from which the best two candidates are fitted again
    shapes: tuple[float, ...] = (0.5, 2.0)
    #: decrease of the deviance (2 log L) by which a fit at a neighbouring period must be better
    better_period: float = 5.0
    #: largest number of effects
    depth: int = 3
    #: runners-up of the first stage from which the search starts again if the first start gives no name
    turns: int = 2
    #: share of a record that the window of the first round covers
    window: float = 0.4
    #: residual energy at the beginning of a record, over the largest of a window, above which the window starts there: the state at rest
    #: is known
    beginning: float = 0.7
    #: smallest window [samples]
    least_window: int = 2000
    #: deviance (2 log L) that a law with more parameters gains by chance
    chance: float = 30.0
    #: chance decrease of the deviance (2 log L) by a law with values that contradict its name
    sure: float = 60.0
    #: gap above which the simulation of a free decay has lost the phase
    lost_phase: float = 0.5
    #: smallest number of samples of a window or segment
    shortest: int = 80
    #: error of an equivalent law on few samples, over the error of the found law (in power), above which the law is dropped
    worst_equivalent: float = 1.5
    #: error of the refitted model (share of the deviation, mean over channels) above which records are compared in segments
    astray: float = 0.5
    #: length of a segment, in the rig's time scale
    segment: float = 16.0
    #: smallest length of a segment, in the time scale of the slowest channel
    least_segment: float = 4.0
    #: largest number of segments to fit, to choose and to report by, each
    segments: int = 30
    #: threads that share the fits; the result does not depend on the number
    jobs: int = 2
    #: time after which the diagnosis ends [s]; None for no limit. Stages that are not finished in their share of the time are left out and
    #: listed in the result, which then depends on the speed of the machine. The compilation of kernels does not count.
    max_seconds: float | None = None
    #: largest lag between the clocks of loggers [s]
    max_lag: float = 0.5
    #: noise that a measured motion, differentiated twice, makes of the computed force (share of its deviation) above which force and motion
    #: swap roles if the data allow it: as much as a model may miss (`Criteria.wide_gap`)
    input_noise: float = 0.1
    #: error of the refitted model with swapped roles, over the error of a straight line through each record, below which the force
    #: determines the motion: half of the power
    swapped_error: float = 0.7
    #: error of the refitted model (share of the deviation) above which the simulation of a mass that no spring holds has drifted away, and the
    #: force that the measured motion needs is diagnosed first
    drifted: float = 0.2
