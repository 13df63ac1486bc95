"""Settings that steer the search: what the search does not try cannot be found, but the settings decide nothing else."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How far the search goes. The settings are an argument of `diagnose` and are returned with the result."""

    #: starts of a law with the smallest misfit whose other sizes are tried, and these sizes, as multiples
    varied: int = 3
    sizes: tuple[float, ...] = (0.25, 4.0, 20.0)
    #: laws that are fitted as first law and as further law of a set, those with the smallest misfit of a start first
    shortlist: int = 30
    shortlist_further: int = 12
    #: Gauss-Newton steps of the first fit of a law, and of fits to the end
    first_steps: int = 3
    further_steps: int = 20
    #: cost over that of the best law, above which a law is not fitted to the end
    hopeless: float = 3.0
    #: laws with several parameters that are fitted to the end, as first law and as further law of a set
    kept: int = 14
    kept_further: int = 6
    #: sets that are scored on the held-out records, of one law and of several
    scored: int = 16
    scored_further: int = 10
    #: sets to which a further law is added
    beam: int = 2
    #: largest number of effects
    depth: int = 3
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
