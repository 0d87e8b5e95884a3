"""What is logged too often is counted instead."""

from rover_runtime.log_limit import LogLimit


def test_each_subject_has_lines_of_its_own_and_the_rest_is_counted():
    log = LogLimit()
    logged = [subject for subject in ("a", "b") * 1000 if log.take(subject)]
    log.take("c")
    assert logged.count("a") == logged.count("b") == 20
    assert log.end_period() == ("a: 980 more, not logged", "b: 980 more, not logged")
    assert log.take("a")
    assert not log.end_period()
