"""Settings that steer the search: what the search does not try cannot be found, but the settings decide nothing else."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How far the search goes. The settings are an argument of `diagnose` and are returned with the result."""

    #: laws whose matches are fitted
    matches: int = 8
    #: laws that are fitted with all samples and their own noise
    finals: int = 4
    #: gap (power of the error over the power of the signal) above which a small effect says little about a large one; above its square the
    #: phase of a motion may be lost
    wide_gap: float = 0.1
    #: largest number of effects
    depth: int = 3
    #: deviance (2 log L) that a law with more parameters gains by chance
    chance: float = 30.0
    #: chance decrease of the deviance (2 log L) by a law with values that contradict its name
    sure: float = 60.0
    #: gap above which the simulation of a free decay has lost the phase
    lost_phase: float = 0.5
    #: smallest number of samples of a window or segment
    shortest: int = 80
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
