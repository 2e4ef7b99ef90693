# Two commands do everything: `make study` runs the main job, `make test` checks the code.
# Both set up .venv first, at the versions that constraints.txt pins.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed

.PHONY: help install study figures docs test storm test-all lint clean
.PHONY: reproduction reproduction-rest reproduction-collapse reproduction-slow tuning

help:            ## Say what each target does
	@grep -E '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed 's/:.*##/ \t/' | expand -t 24

install: $(INSTALLED)  ## Build .venv with everything

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v < (3, 14) else "Pneuma needs Python 3.11 to 3.13; this is %d.%d. Name another: make PYTHON=python3.12 ..." % v)'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps godot-rl==0.8.2  # for tests; it pins an old Gymnasium
	@touch $@

study: install  ## Run the activation study (thesis Fig. 6.5) in the arena at its quick preset, and draw it
	$(call takes_results_alone)
	$(BIN)/pneuma study run activation --world arena --results "$(RESULTS)"
	$(BIN)/pneuma study plot activation --world arena --results "$(RESULTS)"

figures: RESULTS = results
figures: install  ## Draw everything in paper_figures/, the verdicts among it
	$(call takes_results_alone)
	$(BIN)/python -m pneuma.figures.paper paper_figures --results "$(RESULTS)" --beside published-logs=author-logs \
	  --beside published-logs-sb3=author-logs

# --- The reproduction ---------------------------------------------------------------------------
#
# Stopped at any moment, each target goes on where it was. In place of `run`, DO takes any command on a
# study's runs: `make reproduction DO=plan` tells how long it takes, DO=status how far it is, DO=publish writes the tables
# to commit. SEEDS=2 STEPS=4096 is a quick look, and STUDIES="activation clip-range" some of a target's studies;
# UNPUBLISHED=1 trains what no table in $(RESULTS)/published holds, and leaves the rest as it is there;
# RETRY=1 tries runs again that crashed or timed out before.

DO ?= run
RESULTS ?= $(or $(PNEUMA_RESULTS),results)
PNEUMA = $(BIN)/pneuma study $(DO)
BEGUN := $(shell date +%s)

WORLDS = arena text godot
WORLDS_architecture = arena
WORLDS_generalisation = arena
WORLDS_robustness = arena
WORLDS_tabular = text
WORLDS_magic = text
WORLDS_classes = text
WORLDS_published-logs = godot

# What claims fix of chapter 6, by budget where there are several; of the other chapters the preset `paper`.
PRESET = paper
BUDGETS_architecture = 200000 40000

# What of a study's curves is committed, where it is not the usual; outcomes, evaluations and signs of collapse are whatever is left out.
CURVES_tabular = return,length
CURVES_collapse = entropy,dead_units,actions
CURVES_robustness = none
KEPT = $(if $(CURVES_$(1)),--curves $(CURVES_$(1)))

# Of several budgets each but the first has a table of its own.
OWN_TABLE = $(if $(filter-out $(firstword $(BUDGETS_$(1))),$(if $(BUDGETS_$(1)),$(3))),--as $(1)-$(3))

# A study in a world, for one budget; a run that crashed stops no other study, nor does one that cannot be published. Ctrl-C and mistakes
# stop all.
define one
$(PNEUMA) $(1) $(if $(filter run plan,$(DO)),--preset $(or $(PRESET_$(1)),$(PRESET))) --world $(2) \
  $(if $(SEEDS),--seeds $(SEEDS)) $(if $(3),--steps $(3)) $(if $(filter publish,$(DO)),$(KEPT) $(OWN_TABLE)) \
  $(if $(filter run plan,$(DO)),$(if $(UNPUBLISHED),--unpublished)) \
  $(if $(filter run,$(DO)),$(if $(RETRY),--retry-failed)) --results "$(RESULTS)" \
  || { code=$$?; [ $$code = $(if $(filter publish,$(DO)),2,1) ] || exit $$code; failed="$$failed $(1) ($(2))"; };
endef

FAILED = $(if $(filter publish,$(DO)),Not published (why stands above):$$failed.,\
Runs failed of:$$failed. RETRY=1 beside the same words tries those again that crashed.)

define each
@failed=; $(foreach study,$(or $(STUDIES),$(1)),\
$(foreach world,$(or $(WORLDS_$(study)),$(WORLDS)),$(if $(or $(STEPS),$(BUDGETS_$(study))),\
$(foreach steps,$(or $(STEPS),$(BUDGETS_$(study))),$(call one,$(study),$(world),$(steps))),$(call one,$(study),$(world))))) \
took=$$(( $$(date +%s) - $(BEGUN) )); \
echo "$@: $$(( took / 3600 )) h $$(( took / 60 % 60 )) min $$(( took % 60 )) s."; \
[ -z "$$failed" ] || { echo "$(FAILED)"; exit 1; }
endef

reproduction: PRESET = claims
reproduction: install  ## Train chapter 6's small networks: 50 seeds of 1M steps, in all worlds
	$(call each,activation optimizer early gradient-limits hyperparameters clip-range actor-size)

reproduction-slow: PRESET = claims
reproduction-slow: install  ## Train chapter 6's mid and big networks
	$(call each,generalisation architecture)

reproduction-rest: install  ## Train chapters 3 to 5, and the published logs again
	$(call each,tabular policy-gradient sigmoid magic classes perception vision algorithms published-logs)

reproduction-collapse: install  ## Train the crossed studies: collapse and robustness
	$(call each,collapse robustness)

# Of a target that is no study's runs: the words that are theirs are refused, lest somebody who asks for a plan trains.
takes_results_alone = $(if $(filter-out run,$(DO))$(SEEDS)$(STEPS)$(STUDIES)$(UNPUBLISHED)$(RETRY),\
$(error $@ takes $(or $(1),RESULTS) alone; DO, SEEDS, STEPS, STUDIES, UNPUBLISHED and RETRY go with the reproduction))

TUNED_OPTIMIZERS = adam l2 upgd sgd momentum rmsprop
TUNED_ALGORITHMS = ppo trpo a2c dqn double-dqn
RIVALS ?= optimizers algorithms
# What the searches find stands in RESULTS/winners-*.toml, each winner beside its search's base.
tuned = $(foreach name,$(2),$(BIN)/pneuma search run tune-$(name) --preset paper --results "$(RESULTS)" &&) \
rm -f "$(RESULTS)/winners-$(1).toml" && $(BIN)/pneuma search promote $(addprefix tune-,$(2)) \
  --out "$(RESULTS)/winners-$(1).toml" --results "$(RESULTS)" && \
$(BIN)/pneuma study run "$(RESULTS)/winners-$(1).toml" --steps $(3) --results "$(RESULTS)"

tuning: install  ## Tune optimizers and algorithms alike (RIVALS: which), and train the winners on fresh seeds
	$(call takes_results_alone,RESULTS and RIVALS)
	$(if $(filter-out optimizers algorithms,$(RIVALS)),$(error RIVALS=$(RIVALS): must be optimizers, algorithms or both))
	$(if $(filter optimizers,$(RIVALS)),$(call tuned,optimizers,$(TUNED_OPTIMIZERS),1000000))
	$(if $(filter algorithms,$(RIVALS)),$(call tuned,algorithms,$(TUNED_ALGORITHMS),200000))

docs: install  ## Build the pages of docs/ as a site in site/, with all commands and modules; broken links are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

test: install lint  ## Check style and types, and run the fast tests
	$(BIN)/python -m pytest -m 'not slow' -n auto --dist loadfile

storm: install  ## Kill and damage studies at random, and compare every bit
	$(BIN)/python -m tests.study.storm

test-all: test docs  ## The same, then the slow tests, and the links of the pages
	$(BIN)/python -m pytest -m slow

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:           ## Remove what was built; results stay
	rm -rf .venv build dist site *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
