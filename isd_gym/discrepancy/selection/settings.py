"""Numbers that steer the search. What decides is in `criteria`; both are arguments of `diagnose` and come back with it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How far the search goes: it may miss what it does not try, but decides nothing.

    heats, finals: how many hypotheses are fitted to the stretch of a record where the gap is widest, and how many of
    them to all of it. cheap: samples; where the stretches are short, as many hypotheses more as have so many together. far, nearest: gap from which on the score test, which looks at small effects, says too little, and how many
    hypotheses then join that come nearest as they stand. depth: effects at once. turns: runners-up from which the search starts over where one effect is not
    enough. window: share of a record that a heat sees, and the least samples of it. chance, sure (2 log L): what a richer
    relative may gain for nothing, and what a step must gain. lost: gap (power over the signal's) from which on a simulation
    that no input ties to the record has lost its phase. astray: error of the refitted model (share of the deviation,
    mean over channels) from which on records are compared in brief stretches first; brief: their length in the rig's own time scale,
    least_brief: and in that of its slowest channel;
    pieces: how many of them at most to fit, to choose and to report by; shortest: samples of one. outrun: power of the error, as a multiple
    of the chosen one's, from which on another law for the same force is not followed any further. max_lag [s]: how late or early the
    clocks of other loggers may be.
    """

    heats: int = 8
    finals: int = 4
    cheap: int = 40_000
    far: float = 0.1
    nearest: int = 4
    depth: int = 3
    turns: int = 2
    window: float = 0.4
    least_window: int = 2000
    chance: float = 30.0
    sure: float = 60.0
    lost: float = 0.5
    shortest: int = 80
    outrun: float = 1.5
    astray: float = 0.5
    brief: float = 16.0
    least_brief: float = 4.0
    pieces: int = 30
    max_lag: float = 0.5
