# Two commands do all the set-up: `make sweep` and `make test`. Everything else is for people who stay.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Processes of `make test`: two, because each takes up to 2 GiB of memory.
JOBS ?= 2
PYTEST = OMP_NUM_THREADS=1 $(BIN)/pytest -n $(JOBS) --dist worksteal
STAMP := $(VENV)/.installed
export MLFLOW_DISABLE_TELEMETRY := true
# Images of containers often set it; each process would then compile all libraries anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help sweep quick test-random answer answer-anew docs notebooks test test-all check lint ui precision bench-simulator bench-metrics bench-scaling bench-inference bench-training bench-viewer view chaos

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18

$(STAMP): pyproject.toml constraints.txt
	@echo "Creating the environment in $(VENV) (about 3 GB, one to four minutes) ..."
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14) and "ablate needs Python 3.11, 3.12 or 3.13; make PYTHON=python3.12 ...")'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

sweep: $(STAMP) ## simulate, train and compare SA2H, SA2H-att and NSA2H; 10 minutes on two cores with AVX-512
	$(BIN)/python -m ablate -m variant=sa2h,sa2h-att,nsa2h

answer: $(STAMP) ## which components earn their keep, from the runs that docs/results keeps; nothing is trained
	$(BIN)/python scripts/results.py restore
	$(BIN)/python -m ablate task=compare study_name=full_model
	$(BIN)/python -m ablate task=compare study_name=extension
	$(BIN)/python -m ablate task=compare study_name=components
	$(BIN)/python scripts/results.py table

answer-anew: $(STAMP) ## the same with this version of ablate: 61 trainings and 36 of the extension; resumable
	$(BIN)/python -m ablate +study=full_model
	$(BIN)/python -m ablate +study=extension
	$(BIN)/python scripts/results.py keep runs/full_model
	$(BIN)/python scripts/results.py keep runs/extension
	$(BIN)/python scripts/results.py table

notebooks: $(STAMP) ## run the notebooks on the studies in runs/ and keep them with their figures, as notebooks/*.ipynb
	$(BIN)/python scripts/notebooks.py $(ARGS)

docs: $(STAMP) ## the documentation as a site in site/, with the notebooks and the API
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "Open site/index.html, or: $(BIN)/mkdocs serve"

test: $(STAMP) ## style, types and tests
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	($(BIN)/mypy && $(BIN)/lint-imports) & types=$$!; $(PYTEST) -m "not slow"; tests=$$?; wait $$types && exit $$tests

test-all: $(STAMP) check ## the same with the slow tests
	$(PYTEST)

test-random: $(STAMP) ## the tests in a random order; ARGS="--randomly-seed=7" repeats one
	$(PYTEST) -m "not slow" -p randomly $(ARGS)

quick: $(STAMP) ## style, types and tests of what changed, under a minute; ROOM=metrics tests one sub-package
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy & types=$$!; OMP_NUM_THREADS=1 $(BIN)/python scripts/quick.py $(ROOM); tests=$$?; wait $$types && exit $$tests

check: $(STAMP)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

lint: $(STAMP) ## mend what the linter can mend
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

ui: $(STAMP) ## the MLflow pages on http://127.0.0.1:5000
	$(BIN)/mlflow ui --backend-store-uri sqlite:///runs/mlflow.db --host 127.0.0.1 --port 5000 --workers 1

view: $(STAMP) ## the probe in your hand, on http://127.0.0.1:8090; ARGS="scene=folder scene.folder=path runs=runs/quick-fetal"
	$(BIN)/python -m ablate task=view $(ARGS)

bench-simulator: $(STAMP) ## milliseconds of a simulated frame by stage; AGAINST=checkout
	$(BIN)/python benchmarks/simulator.py $(if $(AGAINST),--against $(AGAINST))

bench-scaling: $(STAMP) ## memory and time as sizes double, and what fits in 4 and 24 GiB
	$(BIN)/python benchmarks/scaling.py $(ARGS)

precision: $(STAMP) ## measure docs/numerics.md again; RUNS=folder of trained runs, PRESET=theirs, PATIENT=scene folder
	$(BIN)/python scripts/numerics.py $(if $(RUNS),--runs $(RUNS)) $(if $(PRESET),--preset $(PRESET)) $(if $(PATIENT),--patient $(PATIENT)) $(ARGS)

bench-inference: $(STAMP) ## ms and memory of a generated frame by engine, precision and width; ARGS="--variant lsa2h --size 250 346"
	$(BIN)/python benchmarks/inference.py $(ARGS)

bench-metrics: $(STAMP) ## what scoring a frame costs, metric by metric
	$(BIN)/python benchmarks/metrics.py

bench-training: $(STAMP) ## images a second of a training against a plain loop; ARGS="--variants sa2h --threads 1 --rounds 10"
	PYTHONPATH=tests $(BIN)/python benchmarks/training.py $(ARGS)

bench-viewer: $(STAMP) ## the viewer's frames a second, motion to picture and memory; ARGS="--frames 10000 preset=tiny"
	PYTHONPATH=tests $(BIN)/python benchmarks/viewer.py $(ARGS)

chaos: $(STAMP) ## small studies under faults, for docs/reliability.md; ARGS="--minutes 60", or --only kill,disk
	$(BIN)/python benchmarks/chaos.py $(ARGS)
