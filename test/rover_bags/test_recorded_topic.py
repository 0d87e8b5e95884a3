"""Log times of a recorded topic."""

from msg_schemas import qos, topics
from msg_schemas.specifications import Intent
from rover_bags.files.store import standard_type
from rover_bags.files.write_queue import Source
from rover_bags.recording.recorded_topic import RecordedTopic


def test_a_batch_that_travels_slowly_keeps_its_place_before_the_next():
    topic = RecordedTopic(
        Source(topics.CLOCK, standard_type("rosgraph_msgs/msg/Clock")), qos.profile(Intent.SENSOR)
    )
    slow = [topic.log_time(sent + 9) for sent in (100, 110, 120)]
    fast = [topic.log_time(sent + 1) for sent in (121, 125, 135)]
    assert slow == [109, 119, 129]
    assert fast == [129, 129, 136]
