# make demo    sets up .venv and runs the whole chain on real renders, in a few minutes after the set-up
# make test    sets up .venv and runs the quick tests, in five minutes on two cores
# make test-all  all tests, as CI runs them, and how much of the code they run
# make docs    the documentation as web pages, into dist/docs; warnings are errors
# make linkcheck  tries the pages' links to other sites, which needs the network
# make lint    ruff, mypy, and the check of the Blender extension
# make package sdist, wheel, extension and the bill of materials of .venv, into dist
# make matrix  builds that twice, installs and uses it under each Python and bpy, half an hour; needs Python 3.13 or root
# make gui     the extension in real windows of Blender 4.3 and 5.2; needs root and debootstrap
# make slurm   a sweep as jobs of a real Slurm, which is installed on this machine; needs root
# make results the full run behind docs/explanation/reproduction.md, about an hour on 2 cores

# Each bpy wheel is built for one Python version only; constraints.txt pins one for 3.11 and one for 3.13.
PYTHON ?= python3.11
BIN := .venv/bin
READY := .venv/ready
DOCS_READY := .venv/docs-ready
SPHINX := $(BIN)/python -m sphinx -W --keep-going -n -d dist/doctrees
DEMO := demo
# One process a core; each begins with its share of the tests, in order, and then takes over what others have left.
PARALLEL := -n auto --maxprocesses 8 --dist worksteal

# Tests start hundreds of processes: Python is to keep what it has compiled, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all docs linkcheck lint setup extension package matrix gui slurm results clean

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { \
	  echo "error: $(PYTHON) is missing; install it with: apt-get install python3.11 python3.11-venv" \
	       "(or name one: make PYTHON=/path/to/python3.11 ...)"; exit 2; }
	@echo "setting up .venv: about 620 MB to download, 1.8 GB on disk (Blender's module is most of it)"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt hatchling
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	  --no-build-isolation -e ".[bpy,test]"
	@$(BIN)/python -c "import bpy" || { \
	  echo "error: Blender's module bpy does not load; a system library is missing (named above); install it with:" \
	       "apt-get install libx11-6 libxxf86vm1 libxfixes3 libxi6 libxrender1 libxkbcommon0 libsm6 libice6 libgl1 libegl1"; \
	  exit 2; }
	@touch $(READY)

$(DOCS_READY): $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	  --no-build-isolation -e ".[docs]"
	@touch $(DOCS_READY)

demo: $(READY)
	$(BIN)/python benchmarks/paper_table.py --output $(DEMO)

test: $(READY)
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow"

test-all: $(READY)
	$(BIN)/python -m pytest $(PARALLEL) --cov

docs: $(DOCS_READY)
	$(SPHINX) -q -b html docs dist/docs
	@echo "dist/docs/index.html"

linkcheck: $(DOCS_READY)
	$(SPHINX) -D nb_execution_mode=off -b linkcheck docs dist/linkcheck

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m blender_addon.packaging.build -o dist

extension: $(READY)
	$(BIN)/python -m blender_addon.packaging.build -o dist

package: $(READY)
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(BIN)/python -m hatchling build -d dist
	$(BIN)/python -m blender_addon.packaging.build -o dist
	$(BIN)/python -m blender_addon.packaging.sbom -o dist/environment.cdx.json

matrix: $(READY)
	$(BIN)/python tests/matrix/run.py -o dist/matrix

gui: $(READY)
	$(BIN)/python tests/gui/run.py -o dist/gui

slurm: $(READY)
	benchmarks/slurm/run.sh $(CURDIR)/dist/slurm

results: $(READY)
	$(BIN)/python benchmarks/paper_table.py --output results --poses 100 --resolution 64 --samples 192 \
	  --sets spatial-hog global

clean:
	rm -rf .venv dist demo results
