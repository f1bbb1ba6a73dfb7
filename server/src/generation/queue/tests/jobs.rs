//! Jobs: their order, how they leave the queue, and who pays for their frames.

use super::*;

#[test]
fn within_a_flow_order_is_by_priority_then_age() {
    let mut fixture = Fixture::new(100);
    for (x, priority) in [(1, 10), (2, 30), (3, 20), (4, 30)] {
        fixture.request(1, x, priority, 1000);
    }
    let order: Vec<i32> =
        std::iter::from_fn(|| Some(fixture.turn()).filter(|turn| !turn.is_empty())).flatten().collect();
    assert_eq!(order, [2, 4, 3, 1]);
    assert_eq!((fixture.queue.jobs(), fixture.flows_and_views().0, fixture.queue.waiting()), (0, 0, 0));
}

#[test]
fn a_removed_flow_removes_only_its_own_jobs() {
    let mut fixture = Fixture::new(100);
    fixture.request(1, 1, 1, 10);
    fixture.request(1, 2, 1, 10);
    assert_eq!(fixture.request(2, 2, 1, 10), Enqueued::Coalesced);
    assert_eq!(fixture.queue.remove_flow(own(1)).0, 1);
    assert_eq!(fixture.turn(), [2]);
}

#[test]
fn a_cancelled_job_does_not_run_and_a_running_one_continues() {
    let mut fixture = Fixture::new(100);
    fixture.request(1, 1, 9, 1000);
    fixture.request(1, 2, 5, 1000);
    assert_eq!(fixture.queue.take(1, NO_DEADLINE, fixture.now).chunks, [id(1)]);
    assert_eq!(fixture.queue.cancel(1, id(1)).0, []);
    assert_eq!(fixture.queue.cancel(2, id(2)).0, [], "another flow's");
    assert_eq!(fixture.queue.cancel(1, id(2)).0.len(), 1);
    assert_eq!(fixture.turn(), [0; 0]);
    assert_eq!((fixture.queue.jobs(), fixture.queue.finish(id(1), |_| true).len()), (1, 1));
}

#[test]
fn a_job_without_receivers_is_cancelled() {
    let mut fixture = Fixture::new(100);
    fixture.request(1, 1, 1, 10);
    fixture.receivers.clear();
    let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
    assert_eq!((turn.chunks.len(), turn.cancelled, fixture.queue.jobs()), (0, 1, 0));
}

#[test]
fn explicit_requests_expire_and_requests_of_views_do_not() {
    let mut fixture = Fixture::new(100);
    fixture.request_delivery(Delivery::Exact, 1, 1, 1, 10, Some(4));
    fixture.request_delivery(Delivery::Exact, 1, 2, 1, 10, None);
    let deadline = Duration::from_secs(1);
    let turn = fixture.queue.take(QUANTUM, deadline, fixture.now + Duration::from_secs(2));
    assert_eq!(turn.expired.iter().map(|request| request.chunk.request).collect::<Vec<_>>(), [Some(4)]);
    assert_eq!((turn.chunks, turn.cancelled), (vec![id(2)], 0));
}

#[test]
fn a_full_queue_rejects_new_keys_and_coalesces_known_ones() {
    let mut fixture = Fixture::new(1);
    assert_eq!(fixture.request(1, 1, 1, 10), Enqueued::NewJob);
    assert_eq!(fixture.request(2, 2, 1, 10), Enqueued::Full);
    assert_eq!(fixture.request(2, 1, 1, 10), Enqueued::Coalesced);
    assert_eq!(fixture.queue.jobs(), 1);
}

#[test]
fn a_late_request_for_another_delivery_queues_the_job_again() {
    let mut fixture = Fixture::new(10);
    fixture.request(1, 1, 1, 10);
    assert_eq!(fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).chunks, [id(1)]);
    fixture.request_delivery(Delivery::SeedOnly, 2, 1, 1, 10, None);
    let missing = fixture.queue.missing_frame(id(1), |request| request.delivery == Delivery::Exact);
    assert_eq!(missing.map(|frame| frame.delivery), Some(Delivery::SeedOnly));
    assert_eq!(fixture.queue.finish(id(1), |request| request.delivery == Delivery::Exact).len(), 1);
    assert_eq!(fixture.turn(), [1]);
    assert_eq!(fixture.queue.jobs(), 0);
}

#[test]
fn stale_entries_are_bounded() {
    let mut fixture = Fixture::new(10_000);
    fixture.request(1, 0, 0, 10);
    for x in 1..5000 {
        // Flow 1 requests the same key as flow 2, whose job runs first.
        fixture.request(2, x, 9, 1000);
        fixture.request(1, x, 0, 1000);
        while fixture.queue.jobs() > 1 {
            let Some(key) = fixture.queue.take(1, NO_DEADLINE, fixture.now).chunks.first().copied() else {
                break;
            };
            fixture.queue.finish(key, |_| true);
        }
    }
    let most = fixture.queue.sites.values().map(Site::most_entries).max();
    assert!(most <= Some(2 * site::STALE_ENTRIES), "{most:?}");
}

/// Buckets of two addresses that never refill.
fn buckets() -> [TokenBucket; 2] {
    let limiter = RateLimiter::new(Some(0));
    ["10.0.0.1", "10.0.0.2"].map(|address| limiter.bucket(Some(address.parse().unwrap())))
}

#[test]
fn a_charge_is_returned_once_if_its_job_leaves_unrun() {
    let mut fixture = Fixture::new(100);
    let [first, second] = buckets();
    fixture.bucket = first;
    for x in 1..=4 {
        fixture.request_delivery(Delivery::Exact, 1, x, 1, 10, Some(4));
    }
    fixture.bucket = second;
    assert_eq!(fixture.request(2, 1, 1, 10), Enqueued::Coalesced);
    assert!(fixture.queue.cancel(1, id(1)).1.is_none(), "another flow waits for it");
    assert!(fixture.queue.cancel(2, id(1)).1.is_some());
    assert_eq!(fixture.queue.remove_flow(own(2)).1.len(), 0);
    assert!(fixture.queue.cancel(1, id(2)).1.is_some());
    let later = fixture.now + Duration::from_secs(2);
    let turn = fixture.queue.take(1, Duration::from_secs(1), later);
    assert_eq!((turn.expired.len(), turn.refunds.len()), (2, 2));
    assert_eq!((fixture.queue.jobs(), fixture.queue.waiting()), (0, 0));

    // Of an ended flow: at once, or where turns are turned off, when its jobs are due.
    fixture.request(1, 1, 1, 10);
    assert_eq!(fixture.queue.remove_flow(own(1)).1.len(), 1);
    fixture.request(1, 1, 1, 10);
    fixture.receivers.clear();
    assert_eq!(fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).refunds.len(), 1);
    // The control: a job that runs keeps it.
    fixture.request(1, 1, 1, 10);
    let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
    assert_eq!((turn.chunks.len(), turn.refunds.len()), (1, 0));
    fixture.queue.finish(id(1), |_| true);
    assert_eq!(fixture.queue.remove_flow(own(1)).1.len(), 0);
}

#[test]
fn the_first_frame_of_a_job_is_charged_in_advance_and_others_to_who_asks_for_them() {
    let mut fixture = Fixture::new(10);
    let [first, second] = buckets();
    fixture.bucket = first.clone();
    fixture.request(1, 1, 1, 10);
    fixture.bucket = second.clone();
    fixture.request_delivery(Delivery::SeedOnly, 2, 1, 1, 10, None);
    fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
    let frame = fixture.queue.missing_frame(id(1), |_| false).unwrap();
    let Payment::Advance(charge) = frame.payment else { panic!("{frame:?}") };
    assert_eq!(frame.delivery, Delivery::Exact);
    // The estimate of 10 was charged by the caller, here not at all.
    charge.settle(13);
    assert_eq!(first.tokens(), -3.0);

    let is_exact = |request: &FrameRequest| request.delivery == Delivery::Exact;
    let frame = fixture.queue.missing_frame(id(1), is_exact).unwrap();
    let Payment::Request(path, bucket) = frame.payment else { panic!("{frame:?}") };
    bucket.charge_work(5, Instant::now());
    assert_eq!((frame.delivery, path), (Delivery::SeedOnly, own(2)));
    assert_eq!((first.tokens(), second.tokens()), (-3.0, -5.0));
    // A job that is queued again was run: it is made again at the expense of the second, and not
    // refunded.
    fixture.queue.finish(id(1), is_exact);
    let again = fixture.queue.missing_frame(id(1), |_| false).unwrap();
    assert!(matches!(again.payment, Payment::Request(path, _) if path == own(2)));
    let (cancelled, charge) = fixture.queue.cancel(2, id(1));
    assert!(cancelled.len() == 1 && charge.is_none());
}

#[test]
fn entries_of_a_chunk_that_is_cancelled_and_requested_again_are_bounded() {
    let mut fixture = Fixture::new(10_000);
    for _ in 0..5000 {
        for x in 0..16 {
            fixture.request(1, x, x as u64, 10);
        }
        (0..16).for_each(|x| drop(fixture.queue.cancel(1, id(x))));
    }
    for x in 0..16 {
        fixture.request(1, x, x as u64, 1000);
    }
    let most = fixture.queue.sites.values().map(Site::most_entries).max();
    assert!(most <= Some(2 * site::STALE_ENTRIES), "{most:?}");
    let order: Vec<i32> =
        std::iter::from_fn(|| Some(fixture.turn()).filter(|turn| !turn.is_empty())).flatten().collect();
    assert_eq!(order, (0..16).rev().collect::<Vec<_>>(), "by priority, each once");
}
