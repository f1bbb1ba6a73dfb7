//! Open and closed loops against a server that stalls, on a clock that does not depend on the
//! machine.

mod pipes;

use load::run::run_over;
use load::{LoadConfig, Mode, PathKind, Report, Tally};
use pipes::{Lie, SERVICE, Server, Speaks};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// The stall, seconds from the start.
const STALL_S: (u64, u64) = (3, 5);

/// Requests or poses a second over all clients: the server could do many times as many.
const RATE: f64 = 20.0;

fn config(mode: Mode, rate: Option<f64>) -> LoadConfig {
    let address = "ws://pipe/v1/stream".parse().expect("an address");
    LoadConfig {
        clients: 2,
        seconds: 10,
        mode,
        rate,
        view_distance_m: 200,
        path: PathKind::Walk,
        verify_every: 0,
        ..LoadConfig::new(address)
    }
}

const fn speech(mode: Mode) -> Speaks {
    match mode {
        Mode::Http => Speaks::Http,
        Mode::View | Mode::Explicit => Speaks::WebSocket,
    }
}

async fn load_on(server: Server, config: LoadConfig) -> Report {
    let tally = Arc::new(Tally::new(&config));
    run_over(server, config, tally).await
}

async fn stalled(mode: Mode, rate: Option<f64>) -> Report {
    stalled_over(config(mode, rate)).await
}

async fn stalled_over(config: LoadConfig) -> Report {
    let now = Instant::now();
    let stall = now + Duration::from_secs(STALL_S.0)..now + Duration::from_secs(STALL_S.1);
    let report = load_on(Server { stall, ..Server::new(speech(config.mode)) }, config).await;
    assert_eq!(report.verdict(), Ok(()), "{report}");
    report
}

async fn calm(mode: Mode, rate: Option<f64>) -> Report {
    let report = load_on(Server::new(speech(mode)), config(mode, rate)).await;
    assert_eq!(report.verdict(), Ok(()), "{report}");
    report
}

#[tokio::test(start_paused = true)]
async fn an_open_loop_shows_a_stall_that_a_closed_loop_hides() {
    // A fifth of the run is stalled, so of arrivals at any time a tenth is expected to wait a
    // second or more.
    let service_ms = SERVICE.as_secs_f64() * 1e3;
    for mode in [Mode::Http, Mode::Explicit] {
        let closed = stalled(mode, None).await;
        assert_eq!(closed.loop_, "closed");
        // 16 are open at a time where requests are made by key.
        let p90 = closed.latency_ms.p90.expect("answers");
        assert!(p90 < 17.0 * service_ms, "a closed loop asks little while it waits: {closed}");
        assert!(closed.latency_ms.max.expect("answers") > 1900.0, "though it was there: {closed}");

        let open = stalled(mode, Some(RATE)).await;
        assert_eq!((open.loop_, open.rate), ("open", Some(RATE)));
        assert!(open.latency_ms.p90.expect("answers") > 500.0, "{open}");
        assert!(open.latency_ms.p99.expect("answers") > 1500.0, "{open}");

        // One GET waits for the one before it; requests by key do not.
        let late = open.sent_late_ms.p99.expect("requests") > 1000.0;
        assert_eq!((late, closed.sent_late_ms.p99), (mode == Mode::Http, None), "{open}");

        let control = calm(mode, Some(RATE)).await;
        assert!(control.latency_ms.p99.expect("answers") < 5.0 * service_ms, "without a stall: {control}");
    }
}

#[tokio::test(start_paused = true)]
async fn poses_of_an_open_loop_count_until_their_view_is_complete() {
    // Whoever stays where he is needs nothing, and would not notice a stall.
    let config = || LoadConfig { path: PathKind::Teleport, ..config(Mode::View, Some(RATE)) };
    let open = stalled_over(config()).await;
    assert_eq!((open.measures, open.latency_ms), ("pose to settled view", open.settle_ms));
    assert!(open.latency_ms.p99.expect("views") > 1500.0, "{open}");
    let control = load_on(Server::new(Speaks::WebSocket), config()).await;
    assert!(control.latency_ms.p99.expect("views") < 800.0, "{control}");
}

#[tokio::test(start_paused = true)]
async fn every_arrival_is_accounted_for_whatever_the_server_does() {
    let expected = calm(Mode::Explicit, Some(RATE)).await;
    assert!((150..250).contains(&expected.requests), "20 a second for 10 s: {expected}");
    assert_eq!((expected.unanswered, expected.unsent), (0, 0));
    let second = Duration::from_secs(1);
    for mode in [Mode::Http, Mode::Explicit] {
        // Stalled from the middle until long after the end.
        let now = Instant::now();
        let stall = now + 5 * second..now + 100 * second;
        let report = load_on(Server { stall, ..Server::new(speech(mode)) }, config(mode, Some(RATE))).await;
        assert_eq!(report.requests + report.unsent, expected.requests, "{report}");
        let answers = report.timeline.iter().map(|second| second.answers).sum::<u64>();
        assert_eq!(answers + report.unanswered + report.unsent, expected.requests, "{report}");
        assert!(
            report.unanswered > 0 && report.latency_ms.max > Some(5000.0),
            "what never came counts: {report}"
        );
    }
}

#[tokio::test(start_paused = true)]
async fn the_second_flight_asks_for_what_the_first_asked_for() {
    let run = |seconds, warm_up_s| {
        let config = LoadConfig { seconds, warm_up_s, ..config(Mode::Http, Some(RATE)) };
        load_on(Server::new(Speaks::Http), config)
    };
    let report = run(5, 5).await;
    let [cold, warm] = &report.phases[..] else { panic!("two parts: {report}") };
    assert_eq!((cold.name, warm.name, cold.requests), ("cold", "warm", warm.requests));
    assert_eq!((warm.chunks, warm.not_modified), (0, warm.requests), "all of it is known: {report}");
    assert!(cold.chunks > 0 && report.not_modified >= warm.not_modified);
    let longer = run(7, 5).await;
    assert!(longer.phases[1].chunks > 0, "the control: beyond the warm-up is unknown: {longer}");
}

#[tokio::test(start_paused = true)]
async fn a_stampede_begins_in_one_moment_and_others_do_not() {
    let first_second = |path, clients| async move {
        let config = LoadConfig { path, clients, seconds: 2, ..config(Mode::View, None) };
        load_on(Server::new(Speaks::WebSocket), config).await.timeline[0].chunks
    };
    // At one place everybody needs the same number of chunks at the same time.
    let (one, ten) = (first_second(PathKind::Spawn, 1).await, first_second(PathKind::Spawn, 10).await);
    assert!(one > 0 && ten >= 9 * one, "{one} {ten}");
}

#[tokio::test(start_paused = true)]
async fn every_lie_over_http_is_a_mismatch_and_the_verdict_says_so() {
    for (lie, word) in [
        (Lie::Height, "vertex"),
        (Lie::Bit, "digest"),
        (Lie::Place, "came"),
        (Lie::Tag, "ETag"),
        (Lie::Unchanged, "304"),
        (Lie::World, "announces world"),
    ] {
        let config = LoadConfig { seconds: 1, verify_every: 1, ..config(Mode::Http, Some(RATE)) };
        let report = load_on(Server { lie, ..Server::new(Speaks::Http) }, config).await;
        let verdict = report.verdict().expect_err("a liar passed");
        assert!(verdict.contains("mismatches") && verdict.contains(word), "{lie:?}: {verdict}");
    }
}

#[tokio::test(start_paused = true)]
async fn explicit_requests_are_verified_as_views_are() {
    for (lie, word) in
        [(Lie::Height, "vertex"), (Lie::Bit, "digest"), (Lie::Place, "neither requested nor needed")]
    {
        let config = LoadConfig { seconds: 1, verify_every: 1, ..config(Mode::Explicit, None) };
        let report = load_on(Server { lie, ..Server::new(Speaks::WebSocket) }, config).await;
        let verdict = report.verdict().expect_err("a liar passed");
        assert!(verdict.contains("mismatches") && verdict.contains(word), "{lie:?}: {verdict}");
    }
}

#[tokio::test(start_paused = true)]
async fn refusals_over_http_are_waited_out_and_no_faults() {
    let server = Server { lie: Lie::Refusal, ..Server::new(Speaks::Http) };
    let report = load_on(server, config(Mode::Http, None)).await;
    assert_eq!((report.mismatches, report.dropped, report.chunks), (0, 0, 0), "{report}");
    assert!(
        (18..=22).contains(&report.refused),
        "two clients for 10 s, a second between two tries: {report}"
    );
    assert!(report.verdict().expect_err("nothing arrived").contains("try later"));
}

#[tokio::test(start_paused = true)]
async fn sessions_lost_in_an_open_loop_are_dropped_and_what_was_due_is_not_forgotten() {
    let expected = calm(Mode::Explicit, Some(RATE)).await.requests;
    let server = Server { lie: Lie::HangUp, ..Server::new(Speaks::WebSocket) };
    let report = load_on(server, config(Mode::Explicit, Some(RATE))).await;
    assert!(report.dropped > 2, "{report}");
    assert_eq!(report.requests + report.unsent, expected, "{report}");
    assert!(report.verdict().expect_err("dropped").contains("before their time"));
}

#[tokio::test(start_paused = true)]
async fn slow_and_silent_clients_are_told_apart_and_leave_the_others_figures_alone() {
    let alone = calm(Mode::View, None).await;
    let config = LoadConfig { slow: 3, silent: 4, slow_bytes_per_s: 1000, ..config(Mode::View, None) };
    let report = load_on(Server::new(Speaks::WebSocket), config).await;
    assert_eq!(report.verdict(), Ok(()), "{report}");
    assert_eq!(
        (report.clients, report.chunks, report.requests),
        (alone.clients, alone.chunks, alone.requests)
    );
    let (slow, silent) = (report.slow.as_ref().expect("slow"), report.silent.as_ref().expect("silent"));
    // 1000 bytes a second for 14 s at most, each.
    assert!(slow.bytes > 0 && slow.bytes < 3 * 14_000, "{report}");
    assert_eq!((slow.clients, slow.admitted, slow.stayed), (3, 3, 3), "this server ends nobody: {report}");
    assert_eq!((silent.clients, silent.admitted, silent.stayed), (4, 4, 4), "{report}");
    assert_eq!((silent.chunks, alone.slow, alone.silent), (0, None, None));
}
