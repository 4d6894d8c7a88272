#!/bin/sh
# The package emva1288 takes the saturation point from among saturated levels, where the variance is flat.
# Expected before it was run: of levels of light that go on beyond a full well of 18,000 electrons, its saturation
# capacity is that of the level with the largest variance, some per cent below the well.
# Seen (1.0.2): gain right, and a saturation capacity of 28,000 electrons, which no pixel ever held: the photons
# of a saturated level times the quantum efficiency. It looks for the largest variance from the brightest level down,
# and stops at the first that two dimmer ones do not exceed; on the plateau, chance alone decides. The limits of all fits
# (70 and 95 % of saturation) follow from it. Bursts that end at the first saturated level have no plateau.
# Needs Python 3.11. Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/capacity.py" <<'PYTHON'
import logging
from importlib.metadata import version

import numpy as np
from emva1288.process.data import Data1288
from emva1288.process.results import Results1288

WELL, GAIN, READ, QE, SIZE = 18_000, 0.2, 3.0, 0.6, 100
rng = np.random.default_rng(1)


def frames(electrons, count):
    held = np.minimum(rng.poisson(electrons, size=(count, SIZE, SIZE)), WELL)
    return np.rint(GAIN * (held + rng.normal(scale=READ, size=held.shape)) + 64.0).astype(np.int64)


def kept(stack):
    count = len(stack)
    pvar = count * (count * (stack**2).sum(axis=0) - stack.sum(axis=0) ** 2)
    return {"L": count, "sum": stack.sum(axis=0), "pvar": pvar, "dmean": float(stack[-1].mean() - stack[0].mean())}


def pair(electrons):
    one = kept(frames(electrons, 2))
    return {**one, "sum": int(one["sum"].sum()), "pvar": int(one["pvar"].sum())}


for most in (1.0, 1.6):
    levels = np.arange(0.02, most + 1e-9, 0.02) * WELL
    temporal = {float(k): {0.0: pair(0.0), light / QE: pair(light)} for k, light in enumerate(levels, 1)}
    spatial = {1.0: {0.0: kept(frames(0.0, 4)), 0.5 * WELL / QE: kept(frames(0.5 * WELL, 4))}}
    data = Data1288({"width": SIZE, "height": SIZE, "temporal": temporal, "spatial": spatial}, loglevel=logging.ERROR)
    found = Results1288(data.data, loglevel=logging.ERROR)
    shares = round(float(found.K) / GAIN, 1), float(found.u_e_sat) > 1.1 * WELL
    print("RESULT", version("emva1288"), most, "gain", shares[0], "above the well:", shares[1])
    print("saturation capacity", round(float(found.u_e_sat)), "of a well of", WELL)
PYTHON
python3.11 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet "emva1288==1.0.2" "numpy==1.26.4" "scipy==1.13.1"
"$folder/env/bin/python" "$folder/capacity.py" | tee "$folder/all"
grep RESULT "$folder/all" > "$folder/seen"
printf 'RESULT 1.0.2 1.0 gain 1.0 above the well: False\nRESULT 1.0.2 1.6 gain 1.0 above the well: True\n' \
    | diff - "$folder/seen"
