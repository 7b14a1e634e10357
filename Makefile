# Everything here runs from a bare checkout with python3 (3.11 or newer) and its venv module.
# `make` on its own lists the targets.

PYTHON ?= python3
EXTRAS := sim,canopen,analysis,control,export,shell,cluster,dev
DEMO_EXTRAS := sim,analysis
, := ,

venv := .venv
bin := $(venv)/bin
# The stamps' names follow the content of both files, and a Python that was asked for: an unchanged
# checkout never reinstalls.
asked := $(if $(filter file,$(origin PYTHON)),,$(shell $(PYTHON) -V 2>&1))
inputs := $(firstword $(shell { cat pyproject.toml constraints.txt; echo '$(asked)'; } | cksum))
installed := $(venv)/.installed-$(inputs)
demonstrable := $(or $(wildcard $(installed)),$(venv)/.demo-$(inputs))

# What the Debian package is made of: of the same files it is not made twice.
packed := LICENSE README.md pyproject.toml constraints.txt $(shell find src simulators deploy docs -type f ! -name '*.pyc')

# Without a cache of bytecode each of the processes that the tests start compiles the sources again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test peers quick lint bench board proof branches tables rivals docs wheel compiled deb constraints clean

help:
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 20

demo: $(demonstrable) ## watch the motor being held while disks drop onto its shaft
	@$(bin)/adaptdrive-sim demo motor --speed 2

test: $(installed) peers ## run the test suite, in about five minutes on two processors
	$(bin)/python -m pytest -m 'not proof' --numprocesses 3 --dist worksteal -rfEs --durations=10

peers: # programs that tests talk to and nobody here wrote
	@tools/install-peers

quick: $(installed) ## run the tests that stay in one process
	$(bin)/python -m pytest -m 'unit and not proof' --numprocesses auto --dist worksteal -rfE

lint: $(installed) ## lint, formatting, types and import layers
	$(bin)/ruff check
	$(bin)/ruff format --check
	$(bin)/mypy
	$(bin)/lint-imports

bench: $(installed) ## measure in five minutes what a daemon costs; PAGE=docs/proof/realtime.md writes the table there
	$(bin)/python -m tools.benchmarks.paired $(if $(PAGE),--write-page $(PAGE))

board: $(installed) ## run daemons on a tenth of a core, as on a small board, for five minutes; PAGE as above
	$(bin)/python -m tools.benchmarks.board $(if $(PAGE),--write-page $(PAGE))

proof: $(installed) peers ## run the long forms of the tests and write docs/proof/proof.md and the faults of docs/proof/reliability.md; takes hours
	@tools/vm/prepare || true
	@! command -v dpkg-deb >/dev/null || $(MAKE) --no-print-directory deb
	$(bin)/python -m tools.proof docs/proof/proof.md

branches: $(installed) ## list the lines and branches of the supervised modules that their own tests leave out
	$(bin)/python -m tools.branches

soak: export MINUTES = 120
soak: $(installed) ## let a drive live for DAYS=7 of virtual time and MINUTES=120 of real time, and write docs/proof/proof.md
	$(bin)/python -m tools.proof docs/proof/proof.md soak-virtual soak-real

tables: $(installed) ## run the paper's motor experiment with 20 seeds, and write the tables of docs/proof/control.md
	nice $(bin)/python -m tools.benchmarks.paper_tables $(SEED)

rivals: $(installed) ## compare with other controllers, and write the tables of docs/proof/compared.md
	nice $(bin)/python -m tools.benchmarks.rivals.results

docs: $(installed) ## write the pages that are made from the code
	$(bin)/python -m tools.pages.reference_page docs/configuration.md
	$(bin)/python -m tools.pages.licences docs/licences.md
	$(bin)/python -m tools.pages.columns_page docs/columns.md
	$(bin)/python -m tools.pages.constants_page docs/proof/constants.md
	$(bin)/python -m tools.pages.trips_table docs/operation.md
	$(bin)/python -m tools.pages.limits_table docs/proof/obedience.md
	$(bin)/python -m tools.pages.asyncapi docs/mqtt
	$(bin)/python -m tools.proof.page docs/proof/proof.md docs/proof/reliability.md

wheel: $(installed) ## build the wheel into dist/
	rm -rf dist
	$(bin)/python -m build --wheel --no-isolation

compiled: $(installed) ## build the wheel with compiled modules into build/compiled/
	deploy/compiled-wheel $(bin)/python build/compiled

deb: build/adaptdrive.deb ## build the Debian package into build/, of compiled modules where there is a C compiler

build/adaptdrive.deb: $(installed) $(packed)
	$(MAKE) --no-print-directory compiled || $(MAKE) --no-print-directory wheel
	mkdir -p build
	deploy/debian/build $(bin)/python "$$(ls build/compiled/*.whl 2>/dev/null || ls dist/*.whl)" build

constraints: ## pin the newest versions of all dependencies
	rm -rf build/constraints
	$(PYTHON) -m venv build/constraints
	build/constraints/bin/python -m pip install --quiet --editable '.[$(EXTRAS)]'
	{ echo '# Made by `make constraints`: every version of the environment that the tests passed in.'; \
	  build/constraints/bin/python -m pip freeze --exclude-editable; } > build/constraints.txt
	! grep --invert-match --extended-regexp '^(#.*|[A-Za-z0-9._-]+==[A-Za-z0-9.!+]+)$$' build/constraints.txt
	mv build/constraints.txt constraints.txt

clean: ## remove what was built and cached; the environment in .venv stays
	rm -rf build dist .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find src simulators tests tools -name __pycache__ -prune -exec rm -rf {} +

# What is named here is what the Python of the user, however old, can read.
new_enough := import sys; sys.version_info >= (3, 11) or sys.exit("$(PYTHON) is Python %d.%d, and 3.11 or newer is needed: make PYTHON=python3.11 ..." % sys.version_info[:2])
usable := import pip, sys; sys.exit(sys.version_info < (3, 11) or "$(asked)" not in ("", "Python " + sys.version.split()[0]))

define install # of extras, which are so many packages
	@$(PYTHON) -c '$(new_enough)'
	@echo "installing $(2), once"
	@$(bin)/python -c '$(usable)' 2>/dev/null || { rm -rf $(venv); $(PYTHON) -m venv $(venv); }
	@tools/install-packages $(bin)/python '$(1)'
	@rm -rf $(venv)/lib/python*/site-packages/adaptdrive_sim # a copy, which would hide the source
	@rm -f $(venv)/.installed-* $(venv)/.demo-*
	@touch $@
endef

$(installed):
	$(call install,$(EXTRAS),$(words $(shell grep == constraints.txt)) packages$(,) a minute or two)

$(venv)/.demo-$(inputs):
	$(call install,$(DEMO_EXTRAS),59 packages$(,) less than a minute)
