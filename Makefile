# Two commands do everything: `make study` runs the main job, `make test` checks the code.
# Both set up .venv first, at the versions that constraints.txt pins.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed

.PHONY: help install study figures test storm test-all lint clean

help:            ## Say what each target does
	@grep -E '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed 's/:.*##/ \t/' | expand -t 16

install: $(INSTALLED)  ## Build .venv with everything

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v < (3, 14) else "Pneuma needs Python 3.11 to 3.13; this is %d.%d. Name another: make PYTHON=python3.12 ..." % v)'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

study: install  ## Run the activation study (thesis Fig. 6.5) at its quick preset and draw its figure
	$(BIN)/pneuma study run activation --results results
	$(BIN)/pneuma study plot activation --results results

figures: install  ## Draw everything in paper_figures/
	$(BIN)/python -m pneuma.figures.paper paper_figures

test: install lint  ## Check style and types, and run the fast tests
	$(BIN)/python -m pytest -m 'not slow'

storm: install  ## Kill and damage studies at random, and compare every bit
	$(BIN)/python -m tests.study.storm

test-all: install lint  ## The same with the slow tests
	$(BIN)/python -m pytest

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:           ## Remove what was built; results stay
	rm -rf .venv build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
