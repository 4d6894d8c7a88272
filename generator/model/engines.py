"""The engines and their properties, in one table."""

from __future__ import annotations

from dataclasses import dataclass

AUTO = "auto"
"""The cheapest engine that a scene allows; a sweep takes it if its user names none."""


@dataclass(frozen=True)
class Traits:
    """Properties of an engine that do not depend on the scene.

    Attributes
    ----------
    name, help : str
        Its one name, and a phrase that describes it.
    noisy : bool
        Whether its pictures depend on samples and a seed, as those of Cycles do.
    from_patch : bool
        Whether light starts at the lit patch of the wall; the first reflection must then be known.
    settings : tuple of str
        Fields of `Sweep` that it uses and that not all engines use.
    largest_batch : int
        Largest number of poses that it renders at once.
    """

    name: str
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
            "path", "Cycles from the spot lamp, any scene, very noisy",
            noisy=True, from_patch=False, settings=_OF_CYCLES,
        ),
        Traits(
            "patch", "the lit patch as an emitter, same picture, far less noise",
            noisy=True, from_patch=True, settings=_OF_CYCLES,
        ),
        Traits(
            "surfel",
            "the integral itself, plain diffuse scenes, no noise, far faster; the sky's light, and that of more than "
            "three reflections, to a hundredth of the change",
            noisy=False, from_patch=True, settings=("accuracy",), largest_batch=32,
        ),
    )
}  # fmt: skip
"""In order of cost: the most expensive engine, which any scene allows, comes first."""
AUTO_HELP = "the cheapest that the scene allows, and says why"


def traits_of(engine: str) -> Traits:
    """Return the properties of an engine; KeyError if there is none of that name."""
    return ENGINES[engine]
