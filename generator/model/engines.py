"""The engines and what tells them apart, in one table."""

from __future__ import annotations

from dataclasses import dataclass

AUTO = "auto"
"""The cheapest engine that a scene allows: what a sweep takes where its user names none."""


@dataclass(frozen=True)
class Traits:
    """What is true of an engine, whatever the scene.

    Attributes
    ----------
    name, title, help : str
        As settings name it, as people do, and what it is in a phrase.
    noisy : bool
        Whether its pictures depend on samples and a seed: Cycles' do.
    from_patch : bool
        Whether light starts at the lit patch of the wall, whose first reflection must be known then.
    settings : tuple of str
        Fields of `Sweep` that mean something to it alone.
    largest_batch : int
        Most poses that it renders at once.
    """

    name: str
    title: str
    help: str
    noisy: bool
    from_patch: bool
    settings: tuple[str, ...]
    largest_batch: int = 1


_OF_CYCLES = ("samples", "device", "denoise", "paired")
ENGINES = {
    traits.name: traits
    for traits in (
        Traits(
            "path", "Full Path", "Cycles from the spot lamp, any scene, very noisy",
            noisy=True, from_patch=False, settings=_OF_CYCLES,
        ),
        Traits(
            "patch", "Lit Patch", "the lit patch as an emitter, same picture, far less noise",
            noisy=True, from_patch=True, settings=_OF_CYCLES,
        ),
        Traits(
            "surfel", "Integral",
            "the integral itself, plain diffuse scenes, no noise, far faster, ambient light to a few per cent",
            noisy=False, from_patch=True, settings=("accuracy",), largest_batch=32,
        ),
    )
}  # fmt: skip
"""The dearest first, which any scene allows."""
AUTO_HELP = "the cheapest that the scene allows, and says why"


def traits_of(engine: str) -> Traits:
    """Return what is true of an engine; KeyError if there is none of that name."""
    return ENGINES[engine]
