# Everything this project is asked to do, from a machine that has only Python 3.11 and make.

PYTHON ?= python3.11
SIZE ?=
SCENES ?=
SHIPPED := hat ship console figurine
# Under photographed lights, for the table of that name.
VALUE := book fruit bear drum
SCANS := tea_set marble_bust painted_stool bookshelf coffee_grinder wheelchair forklift tall_plant water_bottle boombox egyptian_cat avocado
# Not datasets/ itself: a render would replace the scenes that the published tables were measured on.
DATASETS ?= results/datasets$(SIZE:%=-%)
ARGS ?=
TRAIN ?= results/prior
NETWORK ?= regressor
PY := .venv/bin/python
BLENDER := .venv-blender/bin/python
DOCS := .venv-docs/bin/python
READY := .venv/.ready
DOCS_READY := .venv-docs/.ready
BLENDER_READY := .venv-blender/.ready

.DEFAULT_GOAL := help
.PHONY: help setup setup-ray setup-notebooks notebooks table value report test test-slow test-gpu verify stability stiffness work-precision lint docs scenes prior-data real-data prior clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-16s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(READY) ## make .venv with the locked versions

# torch goes in first and alone, so that its CPU build is taken where there is one. The rest is complete as it stands and
# goes in without resolving.
$(READY): requirements.lock baselines/pyproject.toml training/pyproject.toml
	$(PYTHON) -m venv --clear .venv
	.venv/bin/pip install --quiet --disable-pip-version-check $$(grep '^torch==' requirements.lock)
	.venv/bin/pip install --quiet --disable-pip-version-check --no-deps -r requirements.lock
	.venv/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable . --editable baselines --editable training
	touch $@

setup-ray: setup ## add Ray to .venv, for tables with launcher=ray (260 MB)
	.venv/bin/pip install --quiet --disable-pip-version-check $$(grep -o '"ray==[^"]*' pyproject.toml | tr -d '"')

setup-notebooks: setup ## add to .venv what runs the notebooks of examples/notebooks, in Jupyter or an editor (30 MB)
	.venv/bin/pip install --quiet --disable-pip-version-check \
		$$(grep '^notebooks = ' pyproject.toml | grep -o '"[a-z]*==[^"]*' | tr -d '"')

notebooks: setup-notebooks ## run the notebooks from top to bottom and keep what they show
	IA_BENCH_DATASETS="$(CURDIR)/datasets" $(PY) examples/notebooks/run.py

table: setup ## our table after the paper's, on our own objects: every row x scene x seed (ARGS="seeds=0,1 scenes=hat preset=full ...")
	.venv/bin/ia-bench table $(ARGS)

value: setup ## what priors are worth with fewer and poorer photographs: four hours of one core (ARGS="table=value_eight", docs/value.md)
	IA_BENCH_DATASETS=$${IA_BENCH_DATASETS:-datasets:$(DATASETS)} \
		.venv/bin/ia-bench table $(if $(findstring table=,$(ARGS)),,table=value) $(ARGS)

TABLE ?= paper
RESULTS = results/$(basename $(notdir $(TABLE)))
report: setup ## the report of a table's runs again, without running (TABLE=ablations RUNS=FOLDER)
	.venv/bin/ia-bench report $(or $(RUNS),$(RESULTS)) --out $(RESULTS) --table $(TABLE) $(ARGS)

test: setup ## the fast tests
	$(PY) -m pytest -n 2 --dist worksteal -m "not slow" $(ARGS)

test-slow: setup ## the slow tests: against Cycles, Ray, a real installation
	$(PY) -m pytest -m slow $(ARGS)

test-gpu: setup ## on a machine with a GPU: rays, kernels and one fit against the CPU
	$(PY) -m pytest -m gpu $(ARGS)

verify: setup ## the correctness battery of the renderer, slow tests included (docs/verification.md)
	$(PY) -m pytest -m verify $(ARGS)

stability: setup ## extreme inputs, one line each, against what the answer must be
	$(PY) -m pytest -m stability -v tests/stability $(ARGS)

stiffness: setup ## how stiff the shipped scenes are, and what their images confuse (some minutes)
	$(PY) -m benchmarks.stiffness $(or $(SCENES),$(SHIPPED) tiny) --out results/stiffness $(ARGS)

work-precision: setup ## error against run time of renders (ARGS="--scene tiny --out FOLDER")
	$(PY) -m benchmarks.work_precision $(ARGS)

lint: setup ## ruff, mypy, import contracts
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/lint-imports
	cd baselines && ../.venv/bin/lint-imports
	cd training && ../.venv/bin/lint-imports

docs: setup $(DOCS_READY) ## every document as a site, results/docs/index.html; fails on a broken link (RUNS=FOLDER TABLE=NAME: the page of another table)
	.venv/bin/ia-bench report $(or $(RUNS),docs/results/runs.csv docs/results/pictured) --out results/published --table $(if $(RUNS),$(TABLE),ablations) >/dev/null
	$(PY) docs/site/settings.py results/published/settings.md
	NO_MKDOCS_2_WARNING=1 $(DOCS) docs/site/build.py

# MkDocs reads the sources without importing them, hence a small environment of its own.
$(DOCS_READY): docs/site/requirements.txt
	$(PYTHON) -m venv --clear .venv-docs
	.venv-docs/bin/pip install --quiet --disable-pip-version-check --no-deps -r $<
	touch $@

# Without SIZE the recipe's own, which is another one for `tiny`.
scenes: $(BLENDER_READY) ## render the shipped scenes again, below results/ (SIZE=512 SCENES="hat ship" DATASETS=FOLDER; SCENES=value: four others; SCENES=scans: twelve, after real-data)
	for scene in $(or $(patsubst scans,$(SCANS),$(patsubst value,$(VALUE),$(SCENES))),$(SHIPPED)); do \
		$(BLENDER) datasets/recipes/render_scene.py $$scene $(SIZE:%=--size %) --out $(DATASETS)/scenes/$$scene || exit 1; \
	done

prior-data: setup ## render training images of the priors (ARGS="out=FOLDER images=20000 seed=1 ...")
	$(PY) -m ia_bench_training.prior_data out=results/prior-data $(ARGS)

real-data: setup ## photographs, lights, objects and textures of others, below results/real (FROM=FOLDER NC=1; docs/real.md)
	$(PY) datasets/real/fetch.py $(if $(FROM),--from "$(FROM)") $(if $(NC),--nc)

prior: setup ## train a prior on real and procedural things, after real-data; resumes (TRAIN=FOLDER NETWORK=regressor ARGS="minutes=60 ...")
	$(PY) -m ia_bench_training.world.make out=$(TRAIN)/world
	$(PY) -m ia_bench_training.world.held_out out=$(TRAIN)/held_out
	$(PY) -m ia_bench_training.train data=$(TRAIN)/world validation=$(TRAIN)/held_out out=$(TRAIN)/$(NETWORK) \
		network.kind=$(NETWORK) init=ia_bench/priors/weights/$(NETWORK) rate=3e-4 muon_rate=0.01 steps=3000 warmup=100 ema=0.998 \
		$(if $(findstring regressor,$(NETWORK)),log_error=0.01) level=0.05 augmentation.cast=0.05 augmentation.permute=0.03 \
		'scenes=[tiny]' validation_images=92 threads=1 $(ARGS)

# Blender as a module pins an older numpy, hence an environment of its own.
$(BLENDER_READY): datasets/recipes/requirements.txt
	$(PYTHON) -m venv --clear .venv-blender
	.venv-blender/bin/pip install --quiet --disable-pip-version-check -r $<
	touch $@

clean: ## remove caches and builds (not results, not environments)
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find ia_bench baselines training benchmarks tests datasets -name __pycache__ -type d -prune -exec rm -rf {} +
