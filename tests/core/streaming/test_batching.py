"""The batch queue: order, bounds, lingering and its end."""

import threading
import time

from rapl_core.streaming.batching import BatchQueue


def test_items_come_in_order_and_in_batches() -> None:
    queue: BatchQueue[int] = BatchQueue(100)
    for number in range(10):
        queue.put(number)
    assert queue.take(4, 1, 0.0) == [0, 1, 2, 3]
    assert queue.take(100, 1, 0.0) == [4, 5, 6, 7, 8, 9]
    assert len(queue) == 0


def test_a_full_queue_loses_the_oldest_and_counts_them() -> None:
    queue: BatchQueue[int] = BatchQueue(3)
    for number in range(5):
        queue.put(number)
    assert queue.overflowed == 2
    assert queue.take(9, 1, 0.0) == [2, 3, 4]


def test_the_reader_lingers_for_the_frames_of_one_step() -> None:
    queue: BatchQueue[int] = BatchQueue(9)

    def publish() -> None:
        for number in range(4):
            queue.put(number)
            time.sleep(0.01)

    thread = threading.Thread(target=publish)
    thread.start()
    assert queue.take(16, 4, 5.0) == [0, 1, 2, 3]
    thread.join()


def test_the_reader_does_not_linger_longer_than_asked() -> None:
    queue: BatchQueue[int] = BatchQueue(9)
    queue.put(1)
    begin = time.monotonic()
    assert queue.take(16, 4, 0.05) == [1]
    assert 0.04 < time.monotonic() - begin < 2.0


def test_closing_wakes_a_waiting_reader() -> None:
    queue: BatchQueue[int] = BatchQueue(9)
    threading.Timer(0.05, queue.close).start()
    assert queue.take(1, 1, 0.0) == []
