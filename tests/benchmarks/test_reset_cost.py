"""The suite `resets`, on few of them."""

from reset_cost import benchmark_resets

SMALL = ["objects.num_objects=1", "objects.num_grasps=100", "collector.num_workers=0"]


def test_memory_is_read_after_each_tenth_of_the_resets(composed):
    row = benchmark_resets(composed("suite=resets", "resets=20", *SMALL))
    assert list(row["megabytes"]) == [2 * tenth for tenth in range(1, 11)]
    assert row["objects"] == 1
    assert 0 < row["median_milliseconds"] <= row["p95_milliseconds"]
