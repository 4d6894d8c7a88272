#!/bin/sh
# numba: copying one array argument into another by a slice, `a[:] = b`, holds a call of the heap; an element loop none.
# Expected before it was run: both compile to a plain copy, as neither makes an array.
# Seen: numba 0.68.1 compiles the slice form with a call that allocates, which copies the source where the two overlap,
# the loop with none. Compiled without the runtime that allocates and counts references (the option `_nrt=False`, as a
# docstring of numba.extending shows it), the slice form is refused. In small functions that are called millions of
# times, allocating and atomic counting can take a large part of the time, and nothing warns of it.
# Exit code 0 if that is still so.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/copies.py" <<'PYTHON'
import re

import numba
import numpy as np


def by_slice(a, b):
    a[:] = b


def by_loop(a, b):
    for k in range(a.shape[0]):
        a[k] = b[k]


def calls(function, **options):
    compiled = numba.njit(**options)(function)
    try:
        compiled(np.zeros(3), np.ones(3))
    except numba.core.errors.NumbaError as error:
        return "refused" if "NRT required but not enabled" in str(error) else str(error)
    [text] = compiled.inspect_llvm().values()
    body = re.search(r"define [^\n]*@_ZN8__main__[^\n]*\{.*?\n\}", text, re.S).group(0)
    return "allocates" if "NRT_Allocate" in body or "NRT_MemInfo_alloc" in body else "does not"


print("RESULT", numba.__version__, "slice:", calls(by_slice), "| loop:", calls(by_loop),
      "| without counting:", calls(by_slice, _nrt=False), "| loop without:", calls(by_loop, _nrt=False))
PYTHON
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numba==0.68.1 numpy==1.26.4
"$folder/venv/bin/python" "$folder/copies.py" | tee "$folder/seen"
printf '%s\n' "RESULT 0.68.1 slice: allocates | loop: does not | without counting: refused | loop without: does not" |
  diff - "$folder/seen"
