# Everything sets itself up: a virtual environment from the locked requirements, and the Debian packages named here.
PYTHON ?= python3
VENV := .venv
PEERS := build/peers-venv
STAMP := $(VENV)/.installed
PACKAGES := libaravis-0.8-0
TEST_PACKAGES := $(PACKAGES) aravis-tools aravis-tools-cli fuse3 libmodbus5 mbpoll
BENCH_PACKAGES := gcc libc6-dev libmodbus-dev
VM_PACKAGES := qemu-system-x86 busybox-static v4l-utils
COMPILE := --quiet --universal --python-version 3.11 --generate-hashes --no-annotate --no-header

.PHONY: help demo test lint format lock clean bench-budget bench-recipe bench-calibration bench-teaching bench-vision bench-geometry-signs bench-robot bench-plc bench-plc-program bench-reaction fuzz-robot fuzz-modbus node-peer

help:
	@echo "make demo          the whole cell on simulators, live in this terminal (options: DEMO='--speed 1 --units 20')"
	@echo "make test          lint, types, import rules, tests"
	@echo "make bench-vision  noise, bias, honesty, refusals and time of the finders beside free peers (BENCH=--help)"
	@echo "make bench-budget  predicted against true placement errors over 10,000 units; the gap seen after placing"
	@echo "make bench-recipe  features recognised in pictures without knowing anything; the watch over focus and light"
	@echo "make bench-calibration  hand-eye against truth, OpenCV and a real arm; lenses (CELLS=20: shorter)"
	@echo "make bench-teaching  golden assembly, verification, hysteresis and run-out against the simulated truth"
	@echo "make bench-geometry-signs  a sign error planted in every term of geometry.py: the whole-cell tests notice each"
	@echo "make bench-robot   the robot driver's round trips against a bare client, its processor time, lines parsed"
	@echo "make test-vm       the V4L2 driver against the Linux kernel's own test camera, in a virtual machine"
	@echo "make bench-plc     the PLC driver beside libmodbus and pymodbus, cost of a 10 ms scan, 10,000 bad answers"
	@echo "make bench-reaction  emergency stop bit in the PLC to the last byte at the robot, 1,000 times, beside 5 MP vision"
	@echo "make bench-plc-program  10,000 commands to the PLC program over a bad wire, each executed once; time of a scan"
	@echo "make fuzz-robot    a million broken inputs at both simulated robot controllers, and at all that the driver reads"
	@echo "make fuzz-modbus   a million broken frames at the Modbus parser of each side"
	@echo "make bench-camera  trigger to numpy for both kinds of camera beside the wire time, viva-genicam and OpenCV; two at once"
	@echo "make soak-camera   10,000 triggers over a network that loses 0.5 % of the packets: every picture exact and the right one"
	@echo "make fuzz-camera   a million broken datagrams at the simulated camera and at the driver, and a broken picture stream"
	@echo "make node-peer     one more foreign Modbus client and server for the tests (needs npm)"
	@echo "make format        format the code"
	@echo "make lock          renew deploy/requirements.lock and tests/requirements.lock from pyproject.toml"
	@echo "make clean         remove the virtual environment and everything built"

demo: $(STAMP) packages
	$(VENV)/bin/cellctl demo $(DEMO)

test: $(STAMP) lint
	@sh deploy/packages.sh $(TEST_PACKAGES)
	CELLCTL_STRICT=1 $(VENV)/bin/pytest -q $(TEST)

lint: $(STAMP)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports --no-cache

bench-geometry-signs: $(STAMP) packages
	$(VENV)/bin/python -m tests.benchmarks.mutate_geometry

bench-budget: $(STAMP)
	$(VENV)/bin/python -m tests.benchmarks.bench_budget
	$(VENV)/bin/python -m tests.benchmarks.bench_gap

bench-recipe: $(STAMP)
	$(VENV)/bin/python -m tests.benchmarks.bench_recipe

bench-calibration: $(STAMP)
	$(VENV)/bin/python -m tests.benchmarks.bench_calibration $(CELLS)

bench-teaching: $(STAMP) packages
	$(VENV)/bin/python -m tests.benchmarks.bench_teaching

bench-vision: $(PEERS)/.installed
	$(PEERS)/bin/python -m tests.benchmarks.bench_vision $(BENCH)

$(PEERS)/.installed: tests/benchmarks/vision/requirements.txt
	$(PYTHON) -m venv --clear $(PEERS)
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check -r $<
	@touch $@

bench-plc: $(STAMP)
	@sh deploy/packages.sh $(BENCH_PACKAGES)
	$(VENV)/bin/python -m tests.benchmarks.bench_plc

bench-reaction: $(STAMP)
	$(VENV)/bin/python -m tests.benchmarks.bench_reaction

bench-robot: $(STAMP)
	$(VENV)/bin/python -m tests.benchmarks.bench_robot

test-vm: $(STAMP)
	@sh deploy/packages.sh $(VM_PACKAGES)
	$(VENV)/bin/python -m tests.vm.vivid $(VM)

.PHONY: test-vm

bench-plc-program: $(STAMP)
	$(VENV)/bin/python -m tests.benchmarks.bench_plc_program

fuzz-robot: $(STAMP)
	$(VENV)/bin/python -m tests.benchmarks.fuzz_robot
	$(VENV)/bin/python -m tests.benchmarks.fuzz_robot_driver

fuzz-modbus: $(STAMP)
	$(VENV)/bin/python -m tests.benchmarks.fuzz_modbus

bench-camera: $(STAMP) packages
	$(VENV)/bin/python -m tests.benchmarks.bench_camera

soak-camera: $(STAMP) packages
	$(VENV)/bin/python -m tests.benchmarks.soak_camera

fuzz-camera: $(STAMP) packages
	$(VENV)/bin/python -m tests.benchmarks.fuzz_camera

.PHONY: bench-camera soak-camera fuzz-camera

node-peer: build/node/.installed

build/node/.installed: tests/peers/node/package-lock.json
	@mkdir -p build/node
	@cp tests/peers/node/package.json tests/peers/node/package-lock.json build/node/
	npm ci --prefix build/node --ignore-scripts --no-audit --no-fund
	@touch $@

format: $(STAMP)
	$(VENV)/bin/ruff check --fix-only .
	$(VENV)/bin/ruff format .

$(STAMP): tests/requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "cellctl needs Python 3.11 or newer with venv: apt-get install python3 python3-venv"; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --require-hashes -r tests/requirements.lock
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

.PHONY: packages
packages:
	@sh deploy/packages.sh $(PACKAGES)

lock: $(STAMP)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check uv
	$(VENV)/bin/uv pip compile $(COMPILE) --extra test pyproject.toml -o tests/requirements.lock
	$(VENV)/bin/uv pip compile $(COMPILE) --extra build --constraints tests/requirements.lock \
		pyproject.toml -o deploy/requirements.lock

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
