//! Open and closed loops against a server that stalls, on a clock that does not depend on the
//! machine.

mod pipes;

use load::run::run_over;
use load::{LoadConfig, Mode, PathKind, Report, RunStats};
use pipes::{Fault, SERVICE, Server, Transport};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use test_support::ChunkFault;
use tokio::time::{Instant, sleep};
use tokio_util::sync::CancellationToken;

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

const fn transport(mode: Mode) -> Transport {
    match mode {
        Mode::Http => Transport::Http,
        Mode::View | Mode::Explicit => Transport::WebSocket,
    }
}

async fn load_on(server: Server, config: LoadConfig) -> Report {
    let stats = Arc::new(RunStats::new(&config));
    run_over(server, config, stats, CancellationToken::new()).await
}

async fn stalled(mode: Mode, rate: Option<f64>) -> Report {
    stalled_over(config(mode, rate)).await
}

async fn stalled_over(config: LoadConfig) -> Report {
    let now = Instant::now();
    let stall = now + Duration::from_secs(STALL_S.0)..now + Duration::from_secs(STALL_S.1);
    let report = load_on(Server { stall, ..Server::new(transport(config.mode)) }, config).await;
    assert_eq!(report.verdict(), Ok(()), "{report}");
    report
}

async fn unloaded(mode: Mode, rate: Option<f64>) -> Report {
    let report = load_on(Server::new(transport(mode)), config(mode, rate)).await;
    assert_eq!(report.verdict(), Ok(()), "{report}");
    report
}

#[tokio::test(start_paused = true)]
async fn an_interrupt_ends_a_run_with_the_report_so_far() {
    for (mode, rate) in [
        (Mode::Http, None),
        (Mode::Http, Some(RATE)),
        (Mode::Explicit, None),
        (Mode::Explicit, Some(RATE)),
        (Mode::View, Some(RATE)),
    ] {
        let background = u32::from(mode == Mode::Explicit);
        let config =
            LoadConfig { seconds: 3600, slow: background, silent: 2 * background, ..config(mode, rate) };
        let (interrupt, stats) = (CancellationToken::new(), Arc::new(RunStats::new(&config)));
        let run = run_over(Server::new(transport(mode)), config, stats, interrupt.clone());
        let later = async {
            sleep(Duration::from_secs(4)).await;
            interrupt.cancel();
        };
        let (report, ()) = tokio::join!(run, later);
        assert!(report.interrupted && report.counts.chunks > 0, "{report}");
        assert!((3.9..4.5).contains(&report.seconds), "the clock of the test: {report}");
        assert_eq!(report.verdict(), Err(format!("interrupted after {:.1} s", report.seconds)));
        // At most one of a client was due in the same millisecond.
        assert!(report.counts.unsent <= 2, "what was not due is no request: {report}");
        assert_eq!((report.counts.dropped, report.counts.stalled), (0, 0), "{report}");
        let silent = report.silent.as_ref().map_or(0, |silent| silent.stayed);
        assert_eq!(silent, u64::from(2 * background), "{report}");
    }
    let whole = unloaded(Mode::Http, None).await;
    assert!(!whole.interrupted, "control");
}

#[tokio::test(start_paused = true)]
async fn an_open_loop_shows_a_stall_that_a_closed_loop_hides() {
    // A fifth of the run is stalled, so a tenth of the arrivals is expected to wait a second or
    // more.
    let service_ms = SERVICE.as_secs_f64() * 1e3;
    for mode in [Mode::Http, Mode::Explicit] {
        let closed = stalled(mode, None).await;
        assert_eq!(closed.loop_, "closed");
        // In explicit mode 16 are outstanding.
        let p90 = closed.latency_ms.p90.expect("answers");
        assert!(p90 < 17.0 * service_ms, "a closed loop sends little while it waits: {closed}");
        assert!(closed.latency_ms.max.expect("answers") > 1900.0, "the maximum shows the stall: {closed}");

        let open = stalled(mode, Some(RATE)).await;
        assert_eq!((open.loop_, open.rate), ("open", Some(RATE)));
        assert!(open.latency_ms.p90.expect("answers") > 500.0, "{open}");
        assert!(open.latency_ms.p99.expect("answers") > 1500.0, "{open}");

        // A GET waits for the previous one; requests by key do not.
        let late = open.sent_late_ms.p99.expect("requests") > 1000.0;
        assert_eq!((late, closed.sent_late_ms.p99), (mode == Mode::Http, None), "{open}");

        let control = unloaded(mode, Some(RATE)).await;
        assert!(control.latency_ms.p99.expect("answers") < 5.0 * service_ms, "without a stall: {control}");
    }
}

#[tokio::test(start_paused = true)]
async fn open_loop_poses_count_until_their_view_is_complete() {
    // A client at rest needs no chunks and would not notice a stall.
    let config = || LoadConfig { path: PathKind::Teleport, ..config(Mode::View, Some(RATE)) };
    let open = stalled_over(config()).await;
    assert_eq!((open.measures, open.latency_ms), ("pose to settled view", open.settle_ms));
    assert!(open.latency_ms.p99.expect("views") > 1500.0, "{open}");
    let control = load_on(Server::new(Transport::WebSocket), config()).await;
    assert!(control.latency_ms.p99.expect("views") < 800.0, "{control}");
}

#[tokio::test(start_paused = true)]
async fn every_arrival_is_accounted_for_on_a_stalled_server() {
    let expected = unloaded(Mode::Explicit, Some(RATE)).await;
    assert!((150..250).contains(&expected.counts.requests), "20 a second for 10 s: {expected}");
    assert_eq!((expected.counts.unanswered, expected.counts.unsent), (0, 0));
    let second = Duration::from_secs(1);
    for mode in [Mode::Http, Mode::Explicit] {
        // Stalled from the middle until long after the end.
        let now = Instant::now();
        let stall = now + 5 * second..now + 100 * second;
        let report =
            load_on(Server { stall, ..Server::new(transport(mode)) }, config(mode, Some(RATE))).await;
        assert_eq!(report.counts.requests + report.counts.unsent, expected.counts.requests, "{report}");
        let answers = report.timeline.iter().map(|second| second.answers).sum::<u64>();
        assert_eq!(
            answers + report.counts.unanswered + report.counts.unsent,
            expected.counts.requests,
            "{report}"
        );
        assert!(
            report.counts.unanswered > 0 && report.latency_ms.max > Some(5000.0),
            "missing answers count: {report}"
        );
    }
}

#[tokio::test(start_paused = true)]
async fn the_second_flight_requests_what_the_first_did() {
    let run = |seconds, warm_up_s| {
        let config = LoadConfig { seconds, warm_up_s, ..config(Mode::Http, Some(RATE)) };
        load_on(Server::new(Transport::Http), config)
    };
    let report = run(5, 5).await;
    let [cold, warm] = &report.phases[..] else { panic!("two phases: {report}") };
    assert_eq!((cold.name, warm.name, cold.counts.requests), ("cold", "warm", warm.counts.requests));
    assert_eq!(
        (warm.counts.chunks, warm.counts.not_modified),
        (0, warm.counts.requests),
        "all chunks are known: {report}"
    );
    assert!(cold.counts.chunks > 0 && report.counts.not_modified >= warm.counts.not_modified);
    let longer = run(7, 5).await;
    assert!(longer.phases[1].counts.chunks > 0, "control: after the warm-up chunks are new: {longer}");
}

#[tokio::test(start_paused = true)]
async fn clients_of_a_stampede_start_at_the_same_time() {
    let first_second = |path, clients| async move {
        let config = LoadConfig { path, clients, seconds: 2, ..config(Mode::View, None) };
        load_on(Server::new(Transport::WebSocket), config).await.timeline[0].chunks
    };
    // At one position all clients need the same number of chunks at the same time.
    let (one, ten) = (first_second(PathKind::Spawn, 1).await, first_second(PathKind::Spawn, 10).await);
    assert!(one > 0 && ten >= 9 * one, "{one} {ten}");
}

#[tokio::test(start_paused = true)]
async fn every_http_fault_is_a_mismatch_in_the_verdict() {
    for (fault, word) in [
        (Fault::Chunk(ChunkFault::Height), "vertex"),
        (Fault::Chunk(ChunkFault::Bit), "digest"),
        (Fault::Chunk(ChunkFault::Place), "came"),
        (Fault::Tag, "ETag"),
        (Fault::Unchanged, "304"),
        (Fault::World, "announces world"),
    ] {
        let config = LoadConfig { seconds: 1, verify_every: 1, ..config(Mode::Http, Some(RATE)) };
        let report = load_on(Server { fault, ..Server::new(Transport::Http) }, config).await;
        let verdict = report.verdict().expect_err("a faulty server passed");
        assert!(verdict.contains("mismatches") && verdict.contains(word), "{fault:?}: {verdict}");
    }
}

#[tokio::test(start_paused = true)]
async fn explicit_requests_are_verified_as_views_are() {
    for (fault, word) in [
        (Fault::Chunk(ChunkFault::Height), "vertex"),
        (Fault::Chunk(ChunkFault::Bit), "digest"),
        (Fault::Chunk(ChunkFault::Place), "neither requested nor needed"),
    ] {
        let config = LoadConfig { seconds: 1, verify_every: 1, ..config(Mode::Explicit, None) };
        let report = load_on(Server { fault, ..Server::new(Transport::WebSocket) }, config).await;
        let verdict = report.verdict().expect_err("a faulty server passed");
        assert!(verdict.contains("mismatches") && verdict.contains(word), "{fault:?}: {verdict}");
    }
}

#[tokio::test(start_paused = true)]
async fn http_refusals_pause_the_client_and_are_no_faults() {
    let server = Server { fault: Fault::Refusal, ..Server::new(Transport::Http) };
    let report = load_on(server, config(Mode::Http, None)).await;
    assert_eq!(
        (report.counts.mismatches, report.counts.dropped, report.counts.chunks),
        (0, 0, 0),
        "{report}"
    );
    assert!(
        (18..=22).contains(&report.counts.refused),
        "two clients for 10 s, a second between two tries: {report}"
    );
    assert!(report.verdict().expect_err("nothing arrived").contains("try later"));
}

#[tokio::test(start_paused = true)]
async fn a_closed_loop_pauses_after_refusals() {
    let server = Server { fault: Fault::Refusal, ..Server::new(Transport::WebSocket) };
    let requests = Arc::clone(&server.requests);
    let report = load_on(server, config(Mode::Explicit, None)).await;
    assert_eq!(
        (report.counts.chunks, report.counts.dropped, report.counts.mismatches),
        (0, 0, 0),
        "{report}"
    );
    assert!(report.verdict().expect_err("nothing arrived").contains("try later"));
    // Two clients for 10 s, 16 requests after each pause of 25 ms to 5 s.
    let requests = requests.load(Ordering::Relaxed);
    assert!((2 * 16 * 5..=2 * 16 * 12).contains(&requests), "{requests}");
}

#[tokio::test(start_paused = true)]
async fn another_world_after_a_restart_ends_the_run_with_both_digests() {
    for mode in [Mode::Explicit, Mode::View] {
        let server = Server { fault: Fault::OtherWorld, ..Server::new(Transport::WebSocket) };
        let config = LoadConfig { clients: 1, seconds: 600, ..config(mode, None) };
        let report = load_on(server, config).await;
        let [first, now] = [1, 2].map(|seed| terrain::Land::new(seed).digest().to_string());
        let verdict = report.verdict().expect_err("the world changed");
        assert!(verdict.contains(&first) && verdict.contains(&now), "{verdict}");
        assert_eq!(report.world_changed.as_ref(), Some(&verdict));
        assert!(report.counts.chunks > 0 && report.seconds < 60.0, "{report}");
    }
    // The control: a server that hangs up and stays the same.
    let server = Server { fault: Fault::HangUp, ..Server::new(Transport::WebSocket) };
    let report = load_on(server, config(Mode::Explicit, None)).await;
    assert!(report.world_changed.is_none() && report.counts.dropped > 0, "{report}");
}

#[tokio::test(start_paused = true)]
async fn an_absent_server_ends_the_run_early_and_a_late_one_does_not() {
    for mode in [Mode::Explicit, Mode::View, Mode::Http] {
        let long = LoadConfig { seconds: 600, warm_up_s: 300, ..config(mode, None) };
        let absent = Server { fault: Fault::Absent, ..Server::new(transport(mode)) };
        let started = Instant::now();
        let report = load_on(absent, long).await;
        assert!((10..30).contains(&started.elapsed().as_secs()), "{:?}: {report}", started.elapsed());
        assert!(report.verdict().expect_err("no server").contains("cannot connect"), "{report}");

        if mode == Mode::View {
            continue;
        }
        let late = Server { fault: Fault::Late, ..Server::new(transport(mode)) };
        let report = load_on(late, config(mode, Some(RATE))).await;
        assert_eq!(report.verdict(), Ok(()), "{report}");
        assert!(report.counts.refused > 0 && report.seconds >= 10.0, "{report}");
    }
}

#[tokio::test(start_paused = true)]
async fn clients_that_never_had_a_session_are_counted_and_fail_the_run() {
    for mode in [Mode::Explicit, Mode::View, Mode::Http] {
        let config = || LoadConfig { clients: 3, seconds: 2, warm_up_s: 2, ..config(mode, None) };
        let full = Server { fault: Fault::Full, ..Server::new(transport(mode)) };
        let report = load_on(full, config()).await;
        // The first client has a session in its first phase only.
        assert_eq!((report.never_connected, report.counts.dropped), (2, 0), "{report}");
        assert!(report.counts.chunks > 0 && report.to_string().contains("no session     2"), "{report}");
        let verdict = report.verdict().expect_err("two clients had no session");
        assert!(verdict.starts_with("2 of 3 clients never had a session; first: "), "{verdict}");
        let report = load_on(Server::new(transport(mode)), config()).await;
        assert_eq!((report.never_connected, report.verdict()), (0, Ok(())), "the control: {report}");
    }
}

#[tokio::test(start_paused = true)]
async fn lost_sessions_of_an_open_loop_keep_their_due_requests() {
    let expected = unloaded(Mode::Explicit, Some(RATE)).await.counts.requests;
    let server = Server { fault: Fault::HangUp, ..Server::new(Transport::WebSocket) };
    let report = load_on(server, config(Mode::Explicit, Some(RATE))).await;
    assert!(report.counts.dropped > 2, "{report}");
    assert_eq!(report.counts.requests + report.counts.unsent, expected, "{report}");
    assert!(report.verdict().expect_err("dropped").contains("before their time"));
}

#[tokio::test(start_paused = true)]
async fn slow_and_silent_clients_do_not_change_other_figures() {
    let alone = unloaded(Mode::View, None).await;
    let config = LoadConfig { slow: 3, silent: 4, slow_bytes_per_s: 1000, ..config(Mode::View, None) };
    let report = load_on(Server::new(Transport::WebSocket), config).await;
    assert_eq!(report.verdict(), Ok(()), "{report}");
    assert_eq!(
        (report.clients, report.counts.chunks, report.counts.requests),
        (alone.clients, alone.counts.chunks, alone.counts.requests)
    );
    let (slow, silent) = (report.slow.as_ref().expect("slow"), report.silent.as_ref().expect("silent"));
    // 1000 bytes a second for 14 s at most, each.
    assert!(slow.bytes > 0 && slow.bytes < 3 * 14_000, "{report}");
    assert_eq!(
        (slow.clients, slow.admitted, slow.stayed),
        (3, 3, 3),
        "this server closes no connection: {report}"
    );
    assert_eq!((silent.clients, silent.admitted, silent.stayed), (4, 4, 4), "{report}");
    assert_eq!((silent.chunks, alone.slow, alone.silent), (0, None, None));
}
