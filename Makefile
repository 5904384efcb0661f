# Needs Python >= 3.11 and pip, nothing else. pip's own settings (PIP_INDEX_URL, ...) are honoured.
#   make demo TORCH_INDEX=https://download.pytorch.org/whl/cpu    without the CUDA packages

PYTHON ?= python3
VENV ?= .venv
TORCH_INDEX ?=
BIN := $(VENV)/bin
READY := $(VENV)/.elast-installed
TORCH := $(shell sed -n 's/^torch==/torch==/p' constraints.txt)

export OMP_NUM_THREADS ?= 1

.PHONY: venv demo test bench bench-quick lint format docs clean

venv: $(READY)

# Debian's Python has no ensurepip without python3-venv: then pip installs itself into the new venv.
$(BIN)/python:
	$(PYTHON) -m venv $(VENV) || { $(PYTHON) -m venv --clear --without-pip $(VENV) && \
		$(PYTHON) -m pip --python $(BIN)/python install pip; }

$(READY): pyproject.toml constraints.txt | $(BIN)/python
	$(if $(TORCH_INDEX),$(BIN)/python -m pip install --index-url $(TORCH_INDEX) $(TORCH))
	$(BIN)/python -m pip install -c constraints.txt -e '.[dev]'
	touch $@

# Data, training, planning and the table of success rates, from nothing, in at most ten minutes.
demo: $(READY)
	$(BIN)/elast run --preset quick --env block-s --methods elast,cpc-cem,random \
		--level hard --episodes 50

test: $(READY)
	$(BIN)/python -m pytest

# Ratios within one run, into docs/results; models are trained on the first run (build/bench).
bench: $(READY)
	$(BIN)/python -m benchmarks --json docs/results/bench.json --profile docs/results/profile.md

# The same with smaller models and fewer repetitions, in at most three minutes.
bench-quick: $(READY)
	$(BIN)/python -m benchmarks --quick

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The documentation as a site in build/site; a broken link, or a page that asks another server, fails.
docs: $(BIN)/python
	$(BIN)/python -m pip install -c constraints.txt "$$(sed -n 's/^docs = \["\(.*\)"\].*/\1/p' pyproject.toml)"
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	$(BIN)/python docs/check_site.py build/site

clean:
	rm -rf build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
