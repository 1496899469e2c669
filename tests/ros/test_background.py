"""Work off the executor's thread."""

import threading
import time

import pytest

from rapl_ros.background import QueueFullError, Worker, future_of, wakeable_future


@pytest.fixture
def worker(probe):
    made = Worker(probe.node, "test worker", capacity=2)
    yield made
    made.close()


def test_jobs_are_done_in_order_in_another_thread(probe, worker):
    seen = []
    futures = [
        worker.submit(lambda n=n: (seen.append(n), threading.current_thread().name)[1])
        for n in range(2)
    ]
    names = [probe.wait(future, 5, "job ends") for future in futures]
    assert seen == [0, 1] and set(names) == {"test worker"}


def test_the_done_callback_runs_on_the_executors_thread(probe, worker):
    where = []
    worker.submit(lambda: 7, lambda f: where.append((threading.current_thread(), f.result())))
    probe.until(lambda: where, 5, "callback")
    assert where == [(threading.current_thread(), 7)]


def test_an_error_is_the_futures(probe, worker):
    def fail():
        raise ValueError("no disk")

    future = worker.submit(fail)
    with pytest.raises(ValueError, match="no disk"):
        probe.wait(future, 5, "job fails")


def test_a_full_queue_refuses_and_never_blocks(probe, worker):
    go_on, begun = threading.Event(), threading.Event()
    worker.submit(lambda: (begun.set(), go_on.wait(10)))
    assert begun.wait(5)
    worker.submit(int)
    worker.submit(int)
    with pytest.raises(QueueFullError, match="test worker has 2 jobs waiting"):
        worker.submit(int)
    assert worker.waiting == 2
    go_on.set()


def test_finish_does_all_that_waits(probe):
    worker = Worker(probe.node, "finisher", capacity=8)
    done = []
    for n in range(5):
        worker.submit(lambda n=n: done.append(n))
    assert worker.finish(timeout_s=5)
    assert done == [0, 1, 2, 3, 4]


def test_finish_has_one_deadline_for_all_it_waits_for(probe):
    worker = Worker(probe.node, "late", capacity=1)
    begun, go_on = threading.Event(), threading.Event()
    worker.submit(lambda: (begun.set(), time.sleep(0.6)))
    assert begun.wait(5)
    worker.submit(lambda: go_on.wait(10))  # the queue has room when this begins
    began_s = time.monotonic()
    assert not worker.finish(timeout_s=1.0)
    assert time.monotonic() - began_s < 1.4
    go_on.set()
    assert worker.close(timeout_s=5)


def test_close_drops_what_waits(probe):
    worker = Worker(probe.node, "closer", capacity=8)
    go_on, begun, done = threading.Event(), threading.Event(), []
    worker.submit(lambda: (begun.set(), go_on.wait(10)))
    worker.submit(lambda: done.append(1))
    assert begun.wait(5)
    assert not worker.close(timeout_s=0.05)  # the first job still runs
    go_on.set()
    assert worker.close(timeout_s=5)
    assert done == []


def test_a_coroutine_that_awaits_a_job_resumes_at_once(probe, worker):
    async def execute():
        return await worker.submit(lambda: 3) + 1

    task = probe.executor.create_task(execute)
    # Nothing else happens on this executor: without a wake-up the spin below would not return.
    for _ in range(10):
        if task.done():
            break
        probe.executor.spin_once(timeout_sec=5)
    assert task.result() == 4


def test_a_node_without_executor_is_told_so(rclpy_context):
    from rclpy.node import Node

    from rapl_core.errors import RaplError

    node = Node("lonely")
    try:
        with pytest.raises(RaplError, match="lonely is on no executor"):
            future_of(node)
    finally:
        node.destroy_node()


def test_a_wakeable_future_may_be_resolved_by_a_thread(probe):
    future = wakeable_future(probe.node)
    threading.Timer(0.05, future.set_result, ["x"]).start()
    assert probe.wait(future, 5, "future resolves") == "x"
