#!/bin/sh
# Makes .venv in the checkout ready: Python packages, and the system libraries for offscreen pictures.
# Usage: tools/setup.sh run|dev    (dev adds what the tests and checks need)
# Safe to repeat: a stamp in .venv makes the second run a matter of milliseconds.
set -eu

kind=${1:-run}
case $kind in run | dev) ;; *) echo "setup: want 'run' or 'dev', got '$kind'" >&2; exit 2 ;; esac
root=$(cd "$(dirname "$0")/.." && pwd -P)
cd "$root"
venv=$root/.venv
say() { echo "setup: $*" >&2; }

# ---------------------------------------------------------------- done already?
# The stamp names what the environment was made from; a moved checkout or a changed pin makes it anew.
stamp=$venv/.ready-$kind
want="$root $(cat pyproject.toml constraints.txt tools/setup.sh sapwood/_version.py | cksum)"
is_ready() { [ -f "$1" ] && [ "$(cat "$1")" = "$want" ]; }
if is_ready "$stamp" || { [ "$kind" = run ] && is_ready "$venv/.ready-dev"; }; then
    "$venv/bin/python" -c "" 2>/dev/null && exit 0
fi

# ---------------------------------------------------------------- a home that cannot be written to
# pip would complain on every line about a cache that it cannot keep.
if [ -z "${HOME:-}" ] || [ ! -w "${HOME:-}" ]; then
    PIP_NO_CACHE_DIR=1
    export PIP_NO_CACHE_DIR
fi
PIP_DISABLE_PIP_VERSION_CHECK=1
PIP_USER=0 # a personal pip.conf may ask for user installs, which no virtual environment allows
export PIP_DISABLE_PIP_VERSION_CHECK PIP_USER

# ---------------------------------------------------------------- apt, for whoever may use it
apt_updated=no
apt_install() {
    command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" = 0 ] || return 1
    if [ $apt_updated = no ]; then
        apt-get update -q >/dev/null 2>&1 || say "apt-get update failed; trying with the lists at hand"
        apt_updated=yes
    fi
    DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends \
        -o DPkg::Lock::Timeout=120 "$@" >/dev/null 2>&1
}

# ---------------------------------------------------------------- Python 3.11 or newer, with venv
# 3.11 first: constraints.txt was made with it.
python=
for candidate in ${PYTHON:-} python3.11 python3 python3.13 python3.12; do
    if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
        python=$candidate
        break
    fi
done
if [ -z "$python" ]; then
    say "Python 3.11 or newer is needed and was not found on PATH. Install it, or run: make PYTHON=/path/to/python3.11"
    exit 1
fi
version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
    apt_install "python$version-venv" || apt_install python3-venv || true
    if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
        say "Python's venv module is missing. Run: sudo apt-get install python$version-venv"
        exit 1
    fi
    say "installed python$version-venv"
fi

# ---------------------------------------------------------------- system libraries
# Offscreen GL for the previews, libusb for Open3D's import. Loading them is the only honest test.
missing=$("$python" - <<'PY'
import ctypes

PACKAGE_OF = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libOpenGL.so.0": "libopengl0",
    "libXrender.so.1": "libxrender1",
}
missing = []
for library, package in PACKAGE_OF.items():
    try:
        ctypes.CDLL(library)
    except OSError:
        missing.append(package)
print(*missing)
PY
)
if [ -n "$missing" ]; then
    # shellcheck disable=SC2086
    if apt_install $missing; then
        say "installed the system libraries $missing"
    else
        say "system libraries are missing; going on without OpenGL and Open3D (pictures are drawn in software)."
        say "To have them, run: sudo apt-get install -y --no-install-recommends $missing"
    fi
fi

# ---------------------------------------------------------------- the environment
if ! "$venv/bin/python" -c 'import pip, sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 ||
    ! grep -qF "$venv" "$venv/bin/pip" 2>/dev/null; then
    say "making .venv with $python ($version)"
    rm -rf "$venv"
    "$python" -m venv "$venv"
fi
rm -f "$venv"/.ready-*
extra=
[ "$kind" = dev ] && extra="[dev]"
say "installing the Python packages (about 1 GB on disk; one to three minutes the first time)"
install() { "$venv/bin/python" -m pip install -q --prefer-binary "$@" -e ".$extra"; }
if [ "$version" = 3.11 ]; then
    install -c constraints.txt || {
        say "pip could not install the pinned packages (its own words are above). Is there a network?"
        exit 1
    }
else
    say "constraints.txt pins versions for Python 3.11; with Python $version the newest that fit are taken"
    install || {
        say "pip could not install the packages (its own words are above). Is there a network?"
        exit 1
    }
fi
echo "$want" >"$stamp"
say "ready"
