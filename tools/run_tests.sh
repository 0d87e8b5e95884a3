#!/bin/sh
# All tests: first, side by side on all cores, those that stay in one process; then, one after the other
# on a machine that is theirs, those that start processes and would measure each other's load.
#
#   tools/run_tests.sh PYTHON [PYTEST ARGUMENT ...]      e.g. tools/run_tests.sh .venv/bin/python -k winch
set -u
python=$1
shift

# pass MARKERS ARGUMENT...: pytest's status, where finding no test to run is none of the faults
pass() {
    markers=$1
    shift
    "$python" -m pytest --timeout=600 -m "$markers" "$@"
    status=$?
    [ "$status" -ne 5 ] || status=0
    return "$status"
}

pass "not process" --numprocesses=auto --maxprocesses=4 --dist=loadfile "$@"
side_by_side=$?
[ "$side_by_side" -ne 2 ] || exit 2 # interrupted
pass process "$@" || exit
exit "$side_by_side"
