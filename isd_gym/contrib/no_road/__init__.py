"""Identification of a linear model without a measured road.

The road is white noise in velocity with an unknown level, and sensors have white noise. The stationary Kalman filter of the
network in the frame of the road gives the likelihood of the records, and the Fisher information gives the
uncertainty of parameters. Motion sensors alone determine ratios to mass; a known force, such as a motor current, sets the scale.

Dry friction counts as a damper of unknown strength, and every further law counts by its slope at rest. A missing nonlinear law moves
parameters out of their plausible range or leaves coloured prediction errors; the verdict is `unknown_effect` then.

`identification` runs the method, `kalman` computes the deviance, `estimation` fits, `decision` applies the gates, and `result`
holds and writes the answer.

References:
    Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, chapter 3.
    Ljung, System Identification, 2nd edition, 1999, section 4.3.
"""

from .identification import MAX_SECONDS, identify
from .result import FOLDER, UnknownInputResult

__all__ = ["FOLDER", "MAX_SECONDS", "UnknownInputResult", "identify"]
