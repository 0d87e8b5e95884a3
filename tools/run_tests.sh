#!/bin/sh
# All tests, side by side: first those that stay in one process, on all cores; then those that start
# processes, two files at a time. One of these that failed beside others, whose load it may have
# measured, is judged by a second run on a machine that is its own.
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
in_one_process=$?
[ "$in_one_process" -ne 2 ] || exit 2 # interrupted
pass process --numprocesses=2 --dist=loadfile "$@"
with_processes=$?
if [ "$with_processes" -eq 1 ]; then
    printf '\nThe failed ones once more, one after the other:\n'
    "$python" -m pytest --timeout=600 -m process --last-failed --last-failed-no-failures=none "$@"
    with_processes=$?
fi
[ "$with_processes" -eq 0 ] || exit "$with_processes"
exit "$in_one_process"
