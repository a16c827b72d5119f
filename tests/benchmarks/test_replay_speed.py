"""The benchmarks of recording and replaying run, and measure what they say."""


def test_it_replays_what_it_recorded_and_prints_a_table():
    import replay_speed

    rows = replay_speed.measure_all(counts=(3,), frames=90, rounds=1, tell=lambda _: None)
    assert [(row.what, row.rules) for row in rows] == [("journal", 3), ("MCAP without pictures", 3)]
    assert all(row.hour_cpu_s > 0 and row.megabytes > 1 for row in rows)
    assert "| journal | 3 |" in replay_speed.markdown(rows)


def test_it_records_in_every_way_and_prints_a_table():
    import recording_cost

    rows = recording_cost.measure_all(frames=20)
    assert len(rows) == len(recording_cost.OPTIONS) + 2
    bytes_of = {row.what: row.cycle_bytes for row in rows}
    assert bytes_of["recording, every picture"] > 10 * bytes_of["recording without pictures"] > 0
    assert "| journal, in its thread |" in recording_cost.markdown(rows)
