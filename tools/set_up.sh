#!/bin/sh
# Make or refresh the project's own virtual environment and install mother_rover in it (editable).
#
#   tools/set_up.sh DIRECTORY [EXTRA ...]       e.g. tools/set_up.sh .venv test bench
#
# PYTHON may name the interpreter to use; otherwise the first Python 3.11 or 3.12 that works is taken.
# Nothing outside DIRECTORY changes. A sourced ROS 2 or another active environment has no effect.
set -eu

unset PYTHONPATH PYTHONHOME VIRTUAL_ENV LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
unset PIP_TARGET PIP_PREFIX
export PIP_USER=0 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_INPUT=1

root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd)
venv=$1
shift
extras=$(IFS=,; echo "$*")
log=$venv/set_up.log

# fail SUMMARY [REMEDY ...]
fail() {
    printf '\nmother_rover: %s\n' "$1" >&2
    shift
    [ $# -eq 0 ] || printf '    %s\n' "$@" >&2
    exit 1
}

# Whether an interpreter runs and is 3.11 or 3.12 (-S: no site packages, -I: no user settings)
is_supported() {
    "$1" -I -S -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' \
        >/dev/null 2>&1
}

can_make_environments() {
    "$1" -I -S -c 'import ensurepip, venv' >/dev/null 2>&1
}

# Candidate interpreters, the best first. A name on PATH may be a wrapper that fails (pyenv), so every
# directory of PATH is searched; pyenv's own versions come last.
candidates() {
    if [ -n "${PYTHON:-}" ]; then
        command -v "$PYTHON" || true
        return
    fi
    for name in python3.12 python3.11 python3 python; do
        (
            IFS=:
            for directory in $PATH; do
                [ ! -x "$directory/$name" ] || echo "$directory/$name"
            done
        )
    done
    for python in "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.1[12].*/bin/python3; do
        [ ! -x "$python" ] || echo "$python"
    done
}

version_of() {
    "$1" -I -S -c 'import platform; print(platform.python_version())'
}

make_environment() {
    supported=
    chosen=
    for python in $(candidates); do
        is_supported "$python" || continue
        supported=${supported:-$python}
        if can_make_environments "$python"; then
            chosen=$python
            break
        fi
    done
    if [ -n "$chosen" ]; then
        "$chosen" -m venv --clear "$venv" || fail "$chosen -m venv failed, see above."
    elif [ -z "$supported" ]; then
        fail "no Python 3.11 or 3.12 found${PYTHON:+ as PYTHON=$PYTHON}." \
            "Install one (Debian 12, Ubuntu 24.04: apt install python3 python3-venv)," \
            "or name it: make ... PYTHON=/path/to/python3.12"
    elif command -v virtualenv >/dev/null 2>&1; then
        chosen=$supported
        virtualenv --quiet --clear --python "$chosen" "$venv" || fail "virtualenv failed, see above."
    else
        fail "$supported cannot make virtual environments: its ensurepip is missing." \
            "Debian and Ubuntu: apt install python3-venv   (or: apt install virtualenv)"
    fi
    echo "Environment $venv: Python $(version_of "$venv/bin/python") of $chosen"
}

# One moving line on a terminal; quiet elsewhere. Everything goes to the log.
show_progress() {
    count=0
    while IFS= read -r line; do
        printf '%s\n' "$line" >>"$log"
        case $line in
            Collecting\ * | *Requirement\ already*) action=finding ;;
            *Downloading\ * | *Using\ cached*) action=fetching ;;
            Installing\ *) action="installing, this takes a while" ;;
            *) continue ;;
        esac
        count=$((count + 1))
        [ ! -t 1 ] || printf '\r  %3d %-40s' "$count" "$action"
    done
    [ ! -t 1 ] || printf '\r%50s\r' ''
}

pip_install() {
    {
        if "$venv/bin/python" -m pip install --progress-bar off \
            --constraint constraints/make.txt "$@" 2>&1; then
            : >"$venv/pip_succeeded"
        fi
    } | show_progress
    if [ -e "$venv/pip_succeeded" ]; then
        rm "$venv/pip_succeeded"
        return
    fi
    tail -n 15 "$log" >&2
    # pip reports the network only in its retries; otherwise an unreachable index looks empty.
    if grep -qE 'ConnectionError|ConnectTimeout|ProxyError|Retrying|from versions: none' "$log"; then
        fail "PyPI cannot be reached; the set-up needs it once." \
            "Check the network; behind a proxy set HTTPS_PROXY, with a mirror set PIP_INDEX_URL," \
            "then run the same command again." "Full log: $log"
    fi
    fail "pip could not install the requirements." "Full log: $log"
}

cd "$root"
if [ -e "$venv/place" ] && [ "$(cat "$venv/place")" != "$root" ]; then
    echo "Environment $venv: recreated, the tree has moved"
    rm -rf "$venv"
fi
if [ -n "${PYTHON:-}" ] && [ -x "$venv/bin/python" ] && is_supported "$PYTHON" &&
    [ "$(version_of "$PYTHON")" != "$(version_of "$venv/bin/python")" ]; then
    echo "Environment $venv: recreated for another version of Python"
    rm -rf "$venv"
fi
if ! { [ -x "$venv/bin/python" ] && is_supported "$venv/bin/python" &&
    "$venv/bin/python" -I -m pip --version >/dev/null 2>&1; }; then
    make_environment
    printf '%s\n' "$root" >"$venv/place"
fi

started=$(date +%s)
echo "Environment $venv: installing mother_rover${extras:+ with extras $extras} (once; needs PyPI)"
: >"$log"
# Build without isolation, so that a later refresh needs no network.
if ! "$venv/bin/python" -c '
import sys
from importlib.metadata import version
sys.exit(int(version("setuptools").split(".")[0]) < 71)' 2>/dev/null; then
    pip_install "setuptools>=71"
fi
pip_install --no-build-isolation --editable ".${extras:+[$extras]}"
# An editable install omits data_files: the ament index entry, node shims, launch and config files.
rm -rf "$venv/lib/mother_rover"
"$venv/bin/python" setup.py --quiet install_data --install-dir "$venv" >>"$log" 2>&1 ||
    fail "could not install the package's data files." "Full log: $log"
echo "Environment $venv: ready after $(($(date +%s) - started)) s"
