#!/bin/sh
# Run all tests in parallel: first those in one process, on all cores; then those that start processes,
# two files at a time. A process test may fail under the load of the others, so the failed ones run
# once more, one after the other.
#
#   tools/run_tests.sh PYTHON [PYTEST ARGUMENT ...]      e.g. tools/run_tests.sh .venv/bin/python -k winch
set -u
python=$1
shift

# pass MARKERS ARGUMENT...: pytest's status; a run without tests passes
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
    printf '\nRunning the failed tests again, one after the other:\n'
    "$python" -m pytest --timeout=600 -m process --last-failed --last-failed-no-failures=none "$@"
    with_processes=$?
fi
[ "$with_processes" -eq 0 ] || exit "$with_processes"
exit "$in_one_process"
