"""Common words of the names of columns and channels: the vocabulary of test benches in English and German, with abbreviations."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...physics.network import Channel, Network

#: synonyms by their common word
_SAME = {
    "acceleration": "acc accel accelerometer acceleration beschleunigung beschl a az acz accz accelz imu",
    "velocity": "vel velo velocity speed geschwindigkeit geschw rate v vz",
    "displacement": "disp displacement position pos travel weg hub stroke stroke length deflection lvdt laser height z x wegaufnehmer distance rel",
    "force": "force kraft load loadcell cell lc f fz newton",
    "current": "current strom i amp amps ampere imotor isoll iist",
    "body": "body sprung chassis aufbau karosserie frame car vehicle fahrzeug upper top s",
    "wheel": "wheel unsprung axle hub rad achse knuckle radtraeger carrier upright u",
    "road": "road street fahrbahn strasse ground shaker platform pad base post table profile",
    "suspension": "suspension damper strut federweg einfederung spring susp federbein",
    "device": "device inerter actuator aktor piston motor",
    "tyre": "tyre tire reifen",
    "input": "input drive command cmd soll demand setpoint excitation anregung",
}
_WORD = {w: key for key, words in _SAME.items() for w in words.split()}
#: abbreviations with little meaning alone
_WEAK = {
    "a",
    "v",
    "x",
    "z",
    "f",
    "i",
    "s",
    "u",
    "rel",
    "cell",
    "top",
    "rate",
    "length",
    "base",
    "table",
}


def tokens(name: str) -> dict[str, float]:
    """Return the words of a name with their weights, as ``accZ_Body1`` -> acceleration, body.

    Args:
        name: Name of a column or channel.

    Returns:
        Weight [-] by word.
    """
    split = re.sub(r"([a-zäöü])([A-ZÄÖÜ])", r"\1 \2", name)
    split = re.sub(r"([A-Za-z])(\d)", r"\1 \2", split)
    out: dict[str, float] = {}
    for word in re.split(r"[^A-Za-zäöüß]+", split):
        low = word.lower()
        if not low:
            continue
        key = _WORD.get(low, low)
        out[key] = max(out.get(key, 0.0), 0.4 if low in _WEAK or len(low) == 1 else 1.0)
    return out


def channel_words(channel: Channel, network: Network) -> dict[str, float]:
    """Return the words that the column of a channel may have: words of the channel's name, quantity and place.

    Args:
        channel: The channel.
        network: The model.

    Returns:
        Weight [-] by word.
    """
    out = tokens(channel.name)
    out[channel.quantity] = max(out.get(channel.quantity, 0.0), 1.0)
    for node in (channel.at, *(channel.between or ()), *channel.elements):
        for word, worth in tokens(str(node or "")).items():
            out[word] = max(out.get(word, 0.0), 0.7 * worth)
    return out


def alike(column: str, channel: Channel, network: Network) -> float:
    """Return the score of a column's name for a channel.

    Args:
        column: Name of the column.
        channel: The channel.
        network: The model.

    Returns:
        Score from -2 to 5.
    """
    if column.strip().lower() == channel.name.lower():
        return 5.0
    own = tokens(column)
    theirs = channel_words(channel, network)
    score = sum(2.0 * worth * theirs[w] for w, worth in own.items() if w in theirs)
    quantities = {"acceleration", "velocity", "displacement", "force", "current"}
    score -= sum(
        1.5 * worth
        for w, worth in own.items()
        if w in quantities and w != channel.quantity and w not in theirs
    )
    places = {"body", "wheel", "road", "tyre"}
    score -= sum(
        1.0 * worth for w, worth in own.items() if w in places and w not in theirs
    )
    return max(-2.0, min(score, 4.5))
