//! Tests of the queue.

mod jobs;

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

/// A flow that is a site of its own.
fn own(flow: FlowId) -> FlowPath {
    FlowPath { site: flow, flow }
}

fn id(x: i32) -> ChunkId {
    ChunkId::base(ChunkKey::new(0, x, 0).unwrap())
}

/// A view job that is never run.
fn view() -> ViewJob {
    let (completion, _) = oneshot::channel();
    ViewJob {
        selection: view_selection(1),
        room: None,
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
    /// The site of all flows; none where each is its own.
    site: Option<SiteId>,
}

impl Fixture {
    fn new(limit: usize) -> Self {
        Self {
            queue: Queue::new(limit),
            now: Instant::now(),
            receivers: FxHashMap::default(),
            bucket: TokenBucket::default(),
            site: None,
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
                turns: FlowPath { site: self.site.unwrap_or(flow), flow },
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
        self.turn_longer_by(0)
    }

    /// As [`Fixture::turn`], of one that takes longer than expected.
    fn turn_longer_by(&mut self, more_us: i64) -> Vec<i32> {
        let turn = self.queue.take(QUANTUM, NO_DEADLINE, self.now);
        if turn.has_work() {
            self.queue.end_turn(turn.path, more_us, None);
        }
        for chunk in &turn.chunks {
            self.queue.finish(*chunk, |_| true);
        }
        turn.chunks.iter().map(|chunk| chunk.key.x()).collect()
    }

    /// Active flows and views that wait.
    fn flows_and_views(&self) -> (usize, usize) {
        let sites = self.queue.sites.values();
        sites.fold((0, 0), |sum, site| (sum.0 + site.flows(), sum.1 + site.waiting_views()))
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
    fixture.queue.add_view(own(3), view());
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
    assert_eq!(fixture.queue.remove_flow(own(1)).0, 0);
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
        fixture.queue.add_view(own(1), view());
        for x in 0..1000 {
            fixture.request(2, x, 1, 100);
        }
        loop {
            let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
            if let Some((_, budget_us)) = turn.view {
                assert!(turn.path == own(1) && budget_us > 0);
                // It costs ten quanta.
                fixture.queue.end_turn(own(1), 10 * QUANTUM, None);
                break;
            }
            fixture.queue.end_turn(turn.path, 0, None);
            turn.chunks.iter().for_each(|key| drop(fixture.queue.finish(*key, |_| true)));
            turns_of_other += 1;
        }
    }
    assert!(turns_of_other >= 9 * 9, "{turns_of_other} turns of the other flow");
    // The control: without other flows the debt delays nothing.
    let mut alone = Fixture::new(10);
    for _ in 0..10 {
        alone.queue.add_view(own(1), view());
        assert!(alone.queue.take(QUANTUM, NO_DEADLINE, alone.now).view.is_some());
        alone.queue.end_turn(own(1), 10 * QUANTUM, None);
    }
    assert_eq!(alone.queue.take(QUANTUM, NO_DEADLINE, alone.now).chunks, []);
    assert_eq!(alone.flows_and_views(), (0, 0));
}

#[test]
fn an_unfinished_view_waits_for_the_next_turn() {
    let mut fixture = Fixture::new(10);
    fixture.queue.add_view(own(1), view());
    fixture.queue.add_view(own(2), view());
    let mut order = Vec::new();
    for _ in 0..6 {
        let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
        order.push(turn.path.flow);
        fixture.queue.end_turn(turn.path, QUANTUM, turn.view.map(|(job, _)| job));
    }
    assert_eq!(order, [1, 2, 1, 2, 1, 2]);
    let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
    fixture.queue.remove_flow(turn.path);
    fixture.queue.end_turn(turn.path, QUANTUM, turn.view.map(|(job, _)| job));
    fixture.queue.remove_flow(own(2));
    assert!(fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).view.is_none());
    assert_eq!(fixture.flows_and_views(), (0, 0));
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
        while fixture.queue.turns.new_len() < 4 {
            next += 1;
            fixture.request(next, 20_000 + next as i32, 1, 2000);
        }
        of_others += usize::from(fixture.turn()[0] < 20_000);
    }
    assert!((200..800).contains(&of_others), "{of_others} of 1000 turns");
}

#[test]
fn debts_of_flows_without_work_are_paid_at_once_where_no_flow_has_work() {
    for site in [None, Some(1)] {
        let mut fixture = Fixture::new(100_000);
        fixture.site = site;
        for flow in 1..=1000 {
            fixture.request(flow, flow as i32, 1, 1_000_000_000);
            assert_eq!(fixture.turn(), [flow as i32]);
        }
        // In a site the flows have not paid while others had work.
        assert_eq!(fixture.flows_and_views().0, 1000);
        assert!(fixture.turn().is_empty());
        assert!(fixture.queue.sites.is_empty() && fixture.queue.turns.len() == 0);
    }
}

#[test]
fn rounds_of_debt_are_skipped_where_all_with_work_are_in_debt() {
    for site in [None, Some(1)] {
        let mut fixture = Fixture::new(100_000);
        fixture.site = site;
        // 10^7 turns of debt each, and work: without the skip this test would last for minutes.
        for flow in 1..=1000 {
            for x in 0..2 {
                fixture.request(flow, flow as i32 * 2 + x, 1, 1_000_000_000);
            }
        }
        for _ in 0..2000 {
            assert_eq!(fixture.turn().len(), 1);
        }
        assert!(fixture.turn().is_empty());
    }
}

#[test]
fn a_site_has_the_same_share_with_many_flows_as_with_one() {
    let mut fixture = Fixture::new(100_000);
    for flow in 1..=100 {
        fixture.site = Some(1);
        for x in 0..20 {
            fixture.request(flow, flow as i32 * 100 + x, 1, 100);
        }
    }
    fixture.site = Some(2);
    for x in 0..1000 {
        fixture.request(200, 20_000 + x, 1, 100);
    }
    let done: Vec<i32> = (0..1000).flat_map(|_| fixture.turn()).collect();
    let of_one = done.iter().filter(|x| **x >= 20_000).count();
    assert!((490..=510).contains(&of_one), "{of_one} of {}", done.len());
    // In the site all flows have the same share.
    for flow in 1..=100 {
        let of_flow = done.iter().filter(|x| **x / 100 == flow).count();
        assert!((3..=7).contains(&of_flow), "{of_flow} of flow {flow}");
    }
}

#[test]
fn a_light_flow_is_first_in_its_site_and_its_site_takes_its_turn() {
    let mut fixture = Fixture::new(100_000);
    for (site, flow) in [(1, 1), (1, 2), (2, 3), (3, 4)] {
        fixture.site = Some(site);
        for x in 0..20 {
            fixture.request(flow, flow as i32 * 100 + x, 1, 100);
        }
    }
    for _ in 0..9 {
        fixture.turn();
    }
    fixture.site = Some(1);
    fixture.request(5, 7, 1, 10);
    assert!((0..3).any(|_| fixture.turn() == [7]));
    // A flow of another site that was idle comes before all.
    fixture.site = Some(9);
    fixture.request(6, 8, 1, 10);
    assert!(fixture.queue.is_next_new(1));
    assert_eq!(fixture.turn(), [8]);
}

#[test]
fn work_that_takes_longer_than_expected_is_paid_by_its_flow_and_its_site() {
    let mut fixture = Fixture::new(100_000);
    for flow in 1..=2 {
        for x in 0..1000 {
            fixture.request(flow, flow as i32 * 1000 + x, 1, 50);
        }
    }
    let (mut of_both, mut spent) = ([0, 0], [0, 0]);
    for _ in 0..300 {
        // Those of the first flow take ten times as long as expected.
        let done = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
        let (flow, count) = (done.path.flow as usize - 1, done.chunks.len());
        let more_us = if flow == 0 { 450 * count as i64 } else { 0 };
        fixture.queue.end_turn(done.path, more_us, None);
        done.chunks.iter().for_each(|chunk| drop(fixture.queue.finish(*chunk, |_| true)));
        of_both[flow] += count;
        spent[flow] += done.expected_us + more_us;
    }
    let ratio = spent[0] as f64 / spent[1] as f64;
    assert!((0.9..1.1).contains(&ratio), "{spent:?} us, {of_both:?} jobs");

    // Work in the turn of another flow is paid, too.
    let mut fixture = Fixture::new(100_000);
    for flow in 1..=2 {
        for x in 0..100 {
            fixture.request(flow, flow as i32 * 1000 + x, 1, 100);
        }
    }
    fixture.queue.charge(own(1), 20 * QUANTUM);
    let first: Vec<i32> = (0..20).flat_map(|_| fixture.turn()).collect();
    assert!(first.iter().filter(|x| **x < 2000).count() <= 1, "{first:?}");
}

#[test]
fn a_flow_whose_work_runs_keeps_its_debt() {
    let mut fixture = Fixture::new(1000);
    fixture.request(1, 1, 1, 10);
    let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
    // Other threads find no work, many times.
    for _ in 0..10 {
        assert!(!fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).has_work());
    }
    fixture.queue.end_turn(turn.path, 50 * QUANTUM, None);
    fixture.queue.finish(id(1), |_| true);
    for x in 0..100 {
        fixture.request(2, 100 + x, 1, 100);
    }
    fixture.request(1, 2, 1, 10);
    let turns: Vec<_> = (0..101).map(|_| fixture.turn()).collect();
    let turn = turns.iter().position(|turn| *turn == [2]);
    assert!(turn > Some(40), "{turns:?}");
}

#[test]
fn the_turn_of_a_site_goes_on_with_its_next_flow() {
    let mut fixture = Fixture::new(100_000);
    let mut light_us = 0;
    fixture.site = Some(2);
    for x in 0..2000 {
        fixture.request(200, 20_000 + x, 1, 10);
    }
    // Fifty flows with one cheap request each, which come again when it is answered.
    fixture.site = Some(1);
    for flow in 1..=50 {
        fixture.request(flow, flow as i32, 1, 10);
    }
    let mut all_us = 0;
    while all_us < 10_000 {
        for x in fixture.turn() {
            all_us += 10;
            if x < 20_000 {
                light_us += 10;
                fixture.request(x as u64, x, 1, 10);
            }
        }
    }
    let share = f64::from(light_us) / f64::from(all_us);
    assert!((0.45..0.55).contains(&share), "{share}");
}

#[test]
fn credit_of_work_that_took_less_than_expected_is_at_most_a_quantum() {
    let mut fixture = Fixture::new(1000);
    fixture.request(1, 1, 1, 50 * QUANTUM);
    let turn = fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now);
    // Another thread finds no work, and the debt of the running flow is forgotten.
    assert!(!fixture.queue.take(QUANTUM, NO_DEADLINE, fixture.now).has_work());
    fixture.queue.end_turn(turn.path, -50 * QUANTUM, None);
    fixture.queue.finish(id(1), |_| true);
    for x in 0..100 {
        fixture.request(1, 100 + x, 1, QUANTUM / 2);
    }
    assert!(fixture.turn().len() <= 3);
}

#[test]
fn work_for_a_flow_that_was_idle_is_paid_when_it_comes() {
    let mut fixture = Fixture::new(1000);
    for x in 0..100 {
        fixture.request(2, 100 + x, 1, 100);
    }
    fixture.queue.charge(own(1), 50 * QUANTUM);
    fixture.request(1, 1, 1, 10);
    let turns: Vec<_> = (0..101).map(|_| fixture.turn()).collect();
    let turn = turns.iter().position(|turn| *turn == [1]);
    assert!(turn > Some(40), "{turns:?}");
}
