//! Tests of the queue.

use super::*;
use crate::generation::result::Completion;
use crate::generation::test_source::view_selection;
use crate::limits::rate_limit::{RateLimiter, TokenBucket};
use crate::traces::RequestTrace;
use protocol::Delivery;
use terrain::ChunkKey;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::sync::oneshot;

const QUANTUM: i64 = 100;
const NO_DEADLINE: Duration = Duration::from_secs(3600);

fn id(x: i32) -> ChunkId {
    ChunkId::base(ChunkKey::new(0, x, 0).unwrap())
}

/// A view job that is never run.
fn view() -> ViewJob {
    let (completion, _) = oneshot::channel();
    ViewJob {
        selection: view_selection(1),
        land: terrain::Land::new(1),
        bucket: TokenBucket::default(),
        spent: Duration::ZERO,
        completion,
    }
}

struct Fixture {
    queue: Queue,
    now: Instant,
    /// Open until the test drops them.
    receivers: FxHashMap<FlowId, UnboundedReceiver<Vec<Completion>>>,
    /// The bucket of the following requests.
    bucket: TokenBucket,
}

impl Fixture {
    fn new(limit: usize) -> Self {
        Self {
            queue: Queue::new(limit),
            now: Instant::now(),
            receivers: FxHashMap::default(),
            bucket: TokenBucket::default(),
        }
    }

    fn request(&mut self, flow: FlowId, x: i32, priority: u64, cost_us: i64) -> Enqueued {
        self.request_delivery(Delivery::Exact, flow, x, priority, cost_us, Some(0))
    }

    fn request_delivery(
        &mut self,
        delivery: Delivery,
        flow: FlowId,
        x: i32,
        priority: u64,
        cost_us: i64,
        request: Option<u32>,
    ) -> Enqueued {
        let (sender, receiver) = unbounded_channel();
        self.receivers.insert(flow * 1_000_000 + x as u64, receiver);
        let chunk = ChunkRequest { key: id(x).key, request, priority };
        self.queue.enqueue(
            FrameRequest {
                flow,
                turns: flow,
                chunk,
                id: id(x),
                delivery,
                must_be_compact: false,
                bucket: self.bucket.clone(),
                since: self.now,
                sender,
                trace: RequestTrace::current(),
            },
            cost_us,
        )
    }

    /// Runs one turn to its end and returns its chunks.
    fn turn(&mut self) -> Vec<i32> {
        let chunks = self.queue.take(QUANTUM, NO_DEADLINE, self.now).chunks;
        for chunk in &chunks {
            self.queue.finish(*chunk, |_| true);
        }
        chunks.iter().map(|chunk| chunk.key.x()).collect()
    }
}

#[test]
fn a_flow_with_many_keys_gets_the_same_share_as_one_with_few() {
    let mut fixture = Fixture::new(10_000);
    for x in 0..1000 {
        fixture.request(1, x, u64::MAX, 10);
    }
    for x in 1000..1030 {
        fixture.request(2, x, 5, 10);
    }
    let done: Vec<i32> = (0..6).flat_map(|_| fixture.turn()).collect();
    let light = done.iter().filter(|x| **x >= 1000).count();
    assert_eq!((done.len(), light), (60, 30), "{done:?}");
}

/// The control of the test above, and what a measurement without turns measures.
#[test]
fn without_turns_jobs_run_in_the_order_of_their_requests() {
    let mut fixture = Fixture::new(10_000);
    fixture.queue = Queue::new(10_000).first_in_first_out();
    for x in 0..50 {
        fixture.request(1, x, 1, 10);
    }
    for x in 50..60 {
        fixture.request(2, x, u64::MAX, 10);
    }
    // A view keeps its own flow.
    fixture.queue.add_view(3, view());
    assert!(fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).view.is_none());
    assert!(fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).view.is_some());
    let done: Vec<i32> = (0..5).flat_map(|_| fixture.turn()).collect();
    assert_eq!(done, (10..60).collect::<Vec<_>>());
}

#[test]
fn without_turns_an_ended_flow_loses_its_jobs_when_they_are_due() {
    let mut fixture = Fixture::new(10);
    fixture.queue = Queue::new(10).first_in_first_out();
    fixture.request(1, 1, 1, 10);
    assert_eq!(fixture.queue.remove_flow(1).0, 0);
    fixture.receivers.clear();
    fixture.request(2, 2, 1, 10);
    assert_eq!(fixture.turn(), [2]);
    assert_eq!(fixture.queue.jobs(), 0);
}

#[test]
fn shares_follow_the_cost_and_an_overdraft_is_paid_back() {
    let mut fixture = Fixture::new(10_000);
    for x in 0..100 {
        fixture.request(1, x, 1, 70);
        fixture.request(2, 1000 + x, 1, 350);
    }
    let (mut cheap_us, mut expensive_us) = (0, 0);
    for _ in 0..70 {
        for x in fixture.turn() {
            if x < 1000 { cheap_us += 70 } else { expensive_us += 350 }
        }
    }
    let ratio = f64::from(cheap_us) / f64::from(expensive_us);
    assert!((0.9..1.1).contains(&ratio), "{cheap_us} against {expensive_us}");
}

#[test]
fn an_idle_flow_is_first_but_only_once_per_round() {
    let mut fixture = Fixture::new(10_000);
    for flow in 1..=50 {
        for x in 0..20 {
            fixture.request(flow, flow as i32 * 100 + x, 1, 100);
        }
    }
    // After their first turns all flows are in the round.
    for _ in 0..60 {
        fixture.turn();
    }
    fixture.request(99, 7, 1, 10);
    assert_eq!(fixture.turn(), [7]);
    // It returns at once, repeatedly: from now on it waits as long as all others.
    let mut others = 0;
    for _ in 0..5 {
        fixture.request(99, 8, 1, 10);
        while fixture.turn() != [8] {
            others += 1;
        }
    }
    assert!(others >= 4 * 49, "{others} turns of others");
}

#[test]
fn the_debt_of_a_view_is_paid_in_rounds_without_other_work() {
    let mut fixture = Fixture::new(10_000);
    let mut turns_of_other = 0;
    for _ in 0..10 {
        fixture.queue.add_view(1, view());
        for x in 0..1000 {
            fixture.request(2, x, 1, 100);
        }
        loop {
            let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
            if let Some((flow, _, budget_us)) = turn.view {
                assert!(flow == 1 && budget_us > 0);
                // It costs ten quanta.
                fixture.queue.return_view(1, None, 10 * QUANTUM);
                break;
            }
            turn.chunks.iter().for_each(|key| drop(fixture.queue.finish(*key, |_| true)));
            turns_of_other += 1;
        }
    }
    assert!(turns_of_other >= 9 * 9, "{turns_of_other} turns of the other flow");
    // The control: without other flows the debt delays nothing.
    let mut alone = Fixture::new(10);
    for _ in 0..10 {
        alone.queue.add_view(1, view());
        assert!(alone.queue.take(QUANTUM, NO_DEADLINE, alone.now).view.is_some());
        alone.queue.return_view(1, None, 10 * QUANTUM);
    }
    assert_eq!(alone.queue.take(QUANTUM, NO_DEADLINE, alone.now).chunks, []);
    assert_eq!((alone.queue.flows.len(), alone.queue.waiting_views()), (0, 0));
}

#[test]
fn an_unfinished_view_waits_for_the_next_turn() {
    let mut fixture = Fixture::new(10);
    fixture.queue.add_view(1, view());
    fixture.queue.add_view(2, view());
    let mut order = Vec::new();
    for _ in 0..6 {
        let (flow, job, _) = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).view.unwrap();
        order.push(flow);
        fixture.queue.return_view(flow, Some(job), QUANTUM);
    }
    assert_eq!(order, [1, 2, 1, 2, 1, 2]);
    let (flow, job, _) = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).view.unwrap();
    fixture.queue.remove_flow(flow);
    fixture.queue.return_view(flow, Some(job), QUANTUM);
    fixture.queue.remove_flow(2);
    assert!(fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).view.is_none());
    assert_eq!(fixture.queue.flows.len(), 0);
}

#[test]
fn within_a_flow_order_is_by_priority_then_age() {
    let mut fixture = Fixture::new(100);
    for (x, priority) in [(1, 10), (2, 30), (3, 20), (4, 30)] {
        fixture.request(1, x, priority, 1000);
    }
    let order: Vec<i32> =
        std::iter::from_fn(|| Some(fixture.turn()).filter(|turn| !turn.is_empty())).flatten().collect();
    assert_eq!(order, [2, 4, 3, 1]);
    assert_eq!((fixture.queue.jobs(), fixture.queue.flows.len(), fixture.queue.waiting()), (0, 0, 0));
}

#[test]
fn a_removed_flow_removes_only_its_own_jobs() {
    let mut fixture = Fixture::new(100);
    fixture.request(1, 1, 1, 10);
    fixture.request(1, 2, 1, 10);
    assert_eq!(fixture.request(2, 2, 1, 10), Enqueued::Coalesced);
    assert_eq!(fixture.queue.remove_flow(1).0, 1);
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
    let most = fixture.queue.flows.values().map(|flow| flow.entries.len()).max();
    assert!(most <= Some(2 * STALE_ENTRIES), "{most:?}");
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
    assert_eq!(fixture.queue.remove_flow(2).1.len(), 0);
    assert!(fixture.queue.cancel(1, id(2)).1.is_some());
    let later = fixture.now + Duration::from_secs(2);
    let turn = fixture.queue.take(1, Duration::from_secs(1), later);
    assert_eq!((turn.expired.len(), turn.refunds.len()), (2, 2));
    assert_eq!((fixture.queue.jobs(), fixture.queue.waiting()), (0, 0));

    // Of an ended flow: at once, or where turns are turned off, when its jobs are due.
    fixture.request(1, 1, 1, 10);
    assert_eq!(fixture.queue.remove_flow(1).1.len(), 1);
    fixture.request(1, 1, 1, 10);
    fixture.receivers.clear();
    assert_eq!(fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).refunds.len(), 1);
    // The control: a job that runs keeps it.
    fixture.request(1, 1, 1, 10);
    let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
    assert_eq!((turn.chunks.len(), turn.refunds.len()), (1, 0));
    fixture.queue.finish(id(1), |_| true);
    assert_eq!(fixture.queue.remove_flow(1).1.len(), 0);
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
    assert!(frame.delivery == Delivery::Exact && frame.payer.is_none());
    let is_exact = |request: &FrameRequest| request.delivery == Delivery::Exact;
    let frame = fixture.queue.missing_frame(id(1), is_exact).unwrap();
    frame.payer.unwrap().charge_work(5, tokio::time::Instant::now());
    assert_eq!((frame.delivery, first.tokens(), second.tokens()), (Delivery::SeedOnly, 0.0, -5.0));
    // A job that is queued again was run: it is made again at the expense of the second, and not
    // refunded.
    fixture.queue.finish(id(1), is_exact);
    assert!(fixture.queue.missing_frame(id(1), |_| false).unwrap().payer.is_some());
    let (cancelled, charge) = fixture.queue.cancel(2, id(1));
    assert!(cancelled.len() == 1 && charge.is_none());
}

#[test]
fn flows_that_come_without_end_leave_the_others_their_turns() {
    let mut fixture = Fixture::new(100_000);
    for flow in 1..=20 {
        for x in 0..900 {
            fixture.request(flow, flow as i32 * 900 + x, 1, 100);
        }
    }
    for _ in 0..40 {
        fixture.turn();
    }
    // Four new flows wait at any time, each with one expensive job.
    let (mut of_others, mut next) = (0, 100);
    for _ in 0..1000 {
        while fixture.queue.new_turns.len() < 4 {
            next += 1;
            fixture.request(next, 20_000 + next as i32, 1, 2000);
        }
        of_others += usize::from(fixture.turn()[0] < 20_000);
    }
    assert!((200..800).contains(&of_others), "{of_others} of 1000 turns");
}

#[test]
fn debts_of_flows_without_work_are_paid_at_once_where_no_flow_has_work() {
    let mut fixture = Fixture::new(100_000);
    for flow in 1..=1000 {
        fixture.request(flow, flow as i32, 1, 1_000_000_000);
        assert_eq!(fixture.turn(), [flow as i32]);
    }
    assert_eq!(fixture.queue.flows.len(), 1000);
    assert!(fixture.turn().is_empty());
    assert!(fixture.queue.flows.is_empty() && fixture.queue.turns.is_empty());
}
