# Everything on a fresh machine: `make demo` trains and shows a policy, `make test` tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
WARP := $(VENV)/.warp

.PHONY: demo test lint coverage docs constraints audit clean

# A second time it resumes the run, which does nothing where its 6 minutes are spent.
demo: $(STAMP)
	@if [ -f runs/demo/checkpoint.pt ]; then \
		echo "make demo: resuming runs/demo, which was begun before; to begin anew: rm -r runs/demo"; \
		$(BIN)/arrive train flat --minutes 6 --resume runs/demo; \
	else \
		$(BIN)/arrive train flat --minutes 6 --out runs/demo; \
	fi
	$(BIN)/arrive eval runs/demo --episodes 1000

test: $(STAMP) $(WARP)
	$(BIN)/ruff check src tests benchmarks scripts examples docs/conf.py
	$(BIN)/mypy
	$(BIN)/python -m pytest -n auto --dist loadfile

lint: $(STAMP)
	$(BIN)/ruff check src tests benchmarks scripts examples docs/conf.py
	$(BIN)/ruff format --check src tests benchmarks scripts examples docs/conf.py
	$(BIN)/mypy

coverage: $(STAMP) $(WARP)
	$(BIN)/python -m pytest --cov=arrive --cov-report=term:skip-covered --cov-report=html:build/coverage

docs: $(STAMP)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs
	@echo "build/docs/index.html"

# What was tested: the versions of everything that is installed here. `pip install -c constraints.txt .` takes the same.
constraints: $(STAMP) $(WARP)
	$(BIN)/python -m pip freeze --exclude-editable | grep -v ' @ ' | sed 's/+cpu$$//' > constraints.txt

# Asks a database of known faults, over the network; only where pip-audit is at hand.
audit: $(STAMP)
	@if command -v pip-audit >/dev/null; then pip-audit --requirement constraints.txt --no-deps --disable-pip; \
	else echo "no pip-audit: known faults of dependencies are not looked up"; fi

$(STAMP): pyproject.toml setup.py
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[test]'
	touch $(STAMP)

# Without its dependencies: it asks for a MuJoCo that would overwrite ours. Without it, its tests are skipped.
$(WARP): $(STAMP)
	-$(BIN)/pip install --quiet --disable-pip-version-check -e '.[gpu]' && \
		$(BIN)/pip install --quiet --disable-pip-version-check --no-deps 'mujoco-warp>=4,<5'
	touch $(WARP)

clean:
	rm -rf $(VENV) build *.egg-info
