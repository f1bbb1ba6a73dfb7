//! The viewer against servers that break the rules. Each one ends with a stated reason, or the view
//! completes once the server is correct; meanwhile chunks, events and texts stay within their
//! bounds.

mod server;
mod wrong_chunks;

use bytes::Bytes;
use client::camera::Projection;
use client::lod::Selection;
use client::native::stream::{EVENT_CAPACITY, ServerStream, Settings, Timeouts};
use client::settings::RenderSettings;
use client::stream::streamer::{Link, WorldStreamer};
use client::stream::trust::MAX_BAD;
use client::stream::{ChunkStream as _, Traffic};
use client::view::ViewParams;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::MAX_SERVER_FRAME;
use protocol::message::{ServerMessage, Settled, Welcome};
use protocol::{DataFrame, Delivery, SUBPROTOCOL};
use server::{Behaviour, HostileServer};
use std::io::Write as _;
use std::net::TcpStream;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};
use terrain::WorldDigest;
use tokio_tungstenite::tungstenite::{ClientRequestBuilder, Message, WebSocket, connect};
use wrong_chunks::{WRONG_CHUNKS, Wrong, far_away, with_heights, with_wrong_digest, wrong_key};

/// Slots of the chunk cache.
const CAPACITY: u32 = 256;

/// Longest line that a server's end may give.
const LONGEST_REASON: usize = 700;

const MS: fn(u64) -> Duration = Duration::from_millis;

/// Waits that are long for a correct server in a debug build.
const LONG: Timeouts = Timeouts {
    connect: MS_CONST[0],
    welcome: MS_CONST[0],
    write: MS_CONST[0],
    ping: MS_CONST[1],
    idle: MS_CONST[0],
    progress: MS_CONST[0],
    first_retry: MS_CONST[2],
    longest_retry: MS_CONST[3],
};
const MS_CONST: [Duration; 4] =
    [Duration::from_secs(20), Duration::from_secs(1), Duration::from_millis(5), Duration::from_millis(40)];

/// Waits for servers that are never correct.
const SHORT: Timeouts =
    Timeouts { connect: Duration::from_secs(1), welcome: MS_CONST[1], progress: MS_CONST[1], ..LONG };

/// Observations of a viewer.
struct Outcome {
    link: Link,
    traffic: Traffic,
    is_complete: bool,
    last_miss: Option<String>,
    /// Causes of ended sessions.
    causes: Vec<String>,
}

impl Outcome {
    /// The reason for which the server was given up.
    fn given_up(&self) -> &str {
        match &self.link {
            Link::GivenUp(cause) => cause,
            other => panic!("not given up: {other:?}"),
        }
    }
}

fn view() -> ViewParams {
    ViewParams {
        pose: "0,200,0,0,-10".parse().unwrap(),
        projection: Projection { fov_deg: 60.0, width: 64, height: 36 },
        view_distance_m: 600,
        tolerance_px: 8.0,
        time_s: 0.0,
        settings: RenderSettings::default(),
    }
}

/// Runs a viewer against a server until it is given up, the view is complete, or so many sessions
/// were lost.
fn run_on(behaviour: Behaviour, change: impl Fn(Settings) -> Settings, most_sessions: usize) -> Outcome {
    run_watched(behaviour, change, most_sessions, |_, _| ())
}

/// [`run_on`] with a callback for each frame: the number of chunks that are bad or refused, and the
/// selection.
fn run_watched(
    behaviour: Behaviour,
    change: impl Fn(Settings) -> Settings,
    most_sessions: usize,
    mut watch: impl FnMut(usize, &Selection),
) -> Outcome {
    let server = HostileServer::start(behaviour);
    let settings = Settings { timeouts: LONG, ..Settings::new(server.url().parse().unwrap()) };
    let stream = ServerStream::connect(change(settings)).unwrap();
    let mut streamer = WorldStreamer::new(stream, CAPACITY);
    let (started, mut causes) = (Instant::now(), Vec::new());
    let (mut was_lost, mut failures) = (false, 0);
    loop {
        // One event at a time, so that every state is seen.
        let selection = streamer.update(&view(), started.elapsed(), 1, |_| ());
        watch(streamer.missed(), &selection);
        let is_complete = streamer.is_settled() && selection.is_complete();
        let (link, traffic) = (streamer.link().clone(), streamer.stream().traffic());
        assert!(streamer.cache().len() <= CAPACITY as usize && traffic.waiting_events <= EVENT_CAPACITY);
        assert!(traffic.credits <= 256 && streamer.missed() <= 1024);
        if let Link::Waiting { cause, .. } | Link::GivenUp(cause) = &link {
            assert!(!cause.contains(char::is_control) && cause.len() <= LONGEST_REASON, "{cause}");
            if !was_lost || streamer.failures() > failures {
                causes.push(cause.clone());
            }
        }
        was_lost = matches!(link, Link::Waiting { .. } | Link::GivenUp(_));
        failures = streamer.failures();
        let is_given_up = matches!(link, Link::GivenUp(_));
        if is_complete || is_given_up || causes.len() >= most_sessions {
            let last_miss = streamer.last_miss().map(str::to_owned);
            return Outcome { link, traffic, is_complete, last_miss, causes };
        }
        assert!(started.elapsed() < Duration::from_secs(120), "{link:?}, {causes:?}, {traffic:?}");
        std::thread::sleep(MS(1));
    }
}

fn run(behaviour: Behaviour) -> Outcome {
    run_on(behaviour, |settings| settings, 100)
}

/// Against a server that is never correct.
fn run_short(behaviour: Behaviour, most_sessions: usize) -> Outcome {
    run_on(behaviour, |settings| Settings { timeouts: SHORT, ..settings }, most_sessions)
}

/// A connection as the server sees it.
type Peer = WebSocket<TcpStream>;

/// Behaviour of a server on a connection.
type Act = Arc<dyn Fn(&mut Peer) + Send + Sync>;

#[test]
fn a_server_of_wrong_chunks_is_given_up_with_what_was_wrong() {
    for (name, wrong, word) in WRONG_CHUNKS {
        let outcome = run(server::always_wrong(wrong));
        let reason = outcome.given_up();
        assert!(reason.contains(word) && reason.contains("8 bad"), "{name}: {reason}");
        assert_eq!(outcome.traffic.bad_chunks, u64::from(MAX_BAD), "{name}");
        assert!(outcome.last_miss.is_some_and(|line| line.contains(word)), "{name}");
    }
}

#[test]
fn a_view_completes_once_the_server_sends_correct_chunks() {
    for (name, wrong, word) in WRONG_CHUNKS {
        let outcome = run(server::wrong_at_first(3, wrong));
        assert!(outcome.is_complete, "{name}: {:?}", outcome.link);
        assert_eq!(outcome.traffic.bad_chunks, 3, "{name}");
        assert!(outcome.last_miss.is_some_and(|line| line.contains(word)), "{name}");
        // A known key is requested again; for an unknown one the session starts again.
        let restarted = outcome.causes.iter().any(|cause| cause.contains("starts again"));
        assert!(outcome.traffic.retried_chunks > 0 || restarted, "{name}: {:?}", outcome.causes);
    }
}

/// The coarsest land is correct, the first three finer chunks are not.
#[test]
fn coarser_land_is_drawn_in_place_of_bad_chunks() {
    const BAD: usize = 3;
    let (coarsest, bad) = (OnceLock::new(), Arc::new(Mutex::new(Vec::new())));
    let sent = Arc::clone(&bad);
    let behaviour = server::always_wrong(move |key| {
        let mut sent = sent.lock().unwrap();
        if key.level() == *coarsest.get_or_init(|| key.level()) || sent.len() == BAD || sent.contains(&key) {
            return Some(server::correct(key));
        }
        sent.push(key);
        with_wrong_digest(key)
    });
    let (mut frames, mut was_drawn) = (0, false);
    let outcome = run_watched(
        behaviour,
        |settings| settings,
        100,
        |missed, selection| {
            // Once the coarsest level is there, something is drawn in each frame.
            was_drawn |= !selection.drawn.is_empty();
            if was_drawn && missed == BAD {
                frames += 1;
                assert!(!selection.is_complete());
                for key in bad.lock().unwrap().iter() {
                    let above = std::iter::successors(key.parent(), |key| key.parent());
                    let is_drawn = |key| selection.drawn.iter().any(|drawn| drawn.key == key);
                    assert_eq!(above.filter(|key| is_drawn(*key)).count(), 1, "above {key:?}");
                }
            }
        },
    );
    assert!(outcome.is_complete, "{:?}", outcome.link);
    assert!(frames > 0, "the three were missing at the same time");
}

/// A viewer of exact chunks does not know the land: heights that keep the rules are drawn.
#[test]
fn heights_of_another_land_complete_the_view_without_a_complaint() {
    let flat: Wrong = |key| with_heights(key, |_| 0);
    // A parent that lies 1 km below its children, farther than its error says.
    let low_parents: Wrong = |key| with_heights(key, |height| height - 1000 * 256 * i32::from(key.level()));
    for (name, other) in [("zero heights", flat), ("parents below their children", low_parents)] {
        let outcome = run(server::always_wrong(other));
        assert!(outcome.is_complete && outcome.causes.is_empty(), "{name}: {:?}", outcome.causes);
        let Traffic { bad_chunks, refused_chunks, retried_chunks, .. } = outcome.traffic;
        assert_eq!((bad_chunks, refused_chunks, retried_chunks), (0, 0, 0), "{name}");
    }
}

/// The control: a client that takes any chunk takes the wrong one.
#[test]
fn without_the_check_of_keys_the_wrong_chunk_is_taken() {
    let server = HostileServer::start(server::always_wrong(wrong_key));
    let request = ClientRequestBuilder::new(server.url().parse().unwrap()).with_sub_protocol(SUBPROTOCOL);
    let (mut socket, _) = connect(request).unwrap();
    let mut session = ClientSession::new(ClientConfig {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: "trusts".into(),
        window: 8,
    });
    session.set_view(view().protocol_view(1));
    loop {
        while let Some(frame) = session.poll_transmit() {
            socket.send(Message::Binary(frame)).unwrap();
        }
        let Message::Binary(frame) = socket.read().unwrap() else { continue };
        if let Event::Chunk { chunk, .. } = session.receive(DataFrame::Binary(&frame)).unwrap() {
            assert_eq!(chunk.key, far_away());
            return;
        }
    }
}

#[test]
fn a_correct_server_completes_the_view_without_a_complaint() {
    let outcome = run(server::always_wrong(|key| Some(server::correct(key))));
    assert!(outcome.is_complete && outcome.causes.is_empty(), "{:?}", outcome.causes);
    let Traffic { bad_chunks, refused_chunks, retried_chunks, .. } = outcome.traffic;
    assert_eq!((bad_chunks, refused_chunks, retried_chunks), (0, 0, 0));
}

#[test]
fn another_world_is_refused() {
    let correct = || server::always_wrong(|key| Some(server::correct(key)));
    let other = run_on(correct(), |settings| Settings { digest: Some(server::NO_WORLD), ..settings }, 100);
    assert!(other.given_up().contains("world"), "{}", other.given_up());
    // A Welcome that names one world, and chunks of another.
    let named = Welcome { digest: server::NO_WORLD.0, ..server::welcome() };
    let lying = run(Arc::new(move |stream, _| {
        let Some(mut socket) = server::websocket(stream) else { return };
        server::send(&mut socket, &ServerMessage::Welcome(named.clone()));
        for key in view().viewer().tops().into_iter().cycle().take(20) {
            let _ = socket.send(Message::Binary(server::correct(key)));
        }
        server::listen(&mut socket);
    }));
    // Chunks that come before the first view are not expected.
    let reason = lying.given_up();
    assert!(reason.contains("digest") || reason.contains("neither requested"), "{reason}");
}

#[test]
fn texts_and_messages_out_of_order_end_the_session_for_good() {
    type Does = fn(&mut Peer);
    let acts: [(&str, Does, &str); 5] = [
        ("texts", |socket| while socket.send(Message::text("x".repeat(100))).is_ok() {}, "binary only"),
        (
            "two Welcomes",
            |socket| {
                let welcome = ServerMessage::Welcome(server::welcome());
                server::send(socket, &welcome);
                server::send(socket, &welcome);
            },
            "second Welcome",
        ),
        (
            "a chunk first",
            |socket| _ = socket.send(Message::Binary(server::correct(far_away()))),
            "before the Welcome",
        ),
        ("no message", |socket| _ = socket.send(Message::binary(vec![7; 50])), "magic"),
        (
            "a list that claims 2^40 bytes",
            |socket| {
                let mut bytes = b"TMBM\x04\0".to_vec();
                bytes.extend([3, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0]);
                let _ = socket.send(Message::binary(bytes));
            },
            "control frame",
        ),
    ];
    for (name, act, word) in acts {
        let outcome = run(Arc::new(move |stream, _| {
            let Some(mut socket) = server::websocket(stream) else { return };
            act(&mut socket);
            server::listen(&mut socket);
        }));
        assert!(outcome.given_up().contains(word), "{name}: {}", outcome.given_up());
    }
}

#[test]
fn frames_without_end_or_of_absurd_length_are_cut_and_counted() {
    // A frame that announces 2^62 bytes; a text in fragments that never ends.
    let announced = |socket: &mut Peer| {
        server::send_raw(socket, &[&[0x82, 127][..], &(1_u64 << 62).to_be_bytes()].concat());
    };
    let endless = |socket: &mut Peer| {
        let part = |first: u8| [&[first, 126][..], &4000_u16.to_be_bytes(), &[b'a'; 4000]].concat();
        let mut stream = socket.get_ref();
        let mut open = stream.write_all(&part(0x01)).is_ok();
        let mut sent = 4000;
        while open {
            open = stream.write_all(&part(0x00)).is_ok();
            sent += 4000;
        }
        assert!(sent > MAX_SERVER_FRAME, "the client read past its limit");
    };
    let acts: [Act; 2] = [Arc::new(announced), Arc::new(endless)];
    for act in acts {
        let outcome = run(Arc::new(move |stream, _| {
            let Some(mut socket) = server::websocket(stream) else { return };
            act(&mut socket);
            server::swallow(socket.get_ref().try_clone().unwrap());
        }));
        let reason = outcome.given_up();
        assert!(reason.contains("8 bad") && reason.contains("too long"), "{reason}");
        assert!(outcome.causes.len() <= MAX_BAD as usize, "{:?}", outcome.causes);
    }
}

#[test]
fn a_server_that_says_nothing_or_drips_is_left_with_a_reason() {
    let silent = |part: usize| -> Behaviour {
        Arc::new(move |stream, _| {
            if part == 0 {
                return server::swallow(stream);
            }
            let Some(mut socket) = server::websocket(stream) else { return };
            if part > 1 {
                server::send(&mut socket, &ServerMessage::Welcome(server::welcome()));
            }
            if part == 3 {
                // A frame of 5,000 bytes, one at a time.
                server::send_raw(&socket, &[0x82, 126, 0x13, 0x88]);
                while socket.get_ref().write_all(b"T").is_ok() {
                    std::thread::sleep(MS(20));
                }
            }
            // Answers pings.
            server::listen(&mut socket);
        })
    };
    for (part, word) in [(0, "does not answer"), (1, "no welcome"), (2, "no chunk"), (3, "no chunk")] {
        let outcome = run_short(silent(part), 2);
        assert!(outcome.causes.iter().all(|cause| cause.contains(word)), "{part}: {:?}", outcome.causes);
        assert_eq!(outcome.causes.len(), 2, "it is tried again");
    }
}

/// After the Welcome.
#[test]
fn a_server_that_stops_answering_pings_is_left_and_one_that_answers_is_not() {
    let behaviour = |answers_pings: bool| -> Behaviour {
        Arc::new(move |stream, _| {
            let Some(mut socket) = server::websocket(stream) else { return };
            server::send(&mut socket, &ServerMessage::Welcome(server::welcome()));
            if answers_pings {
                return server::listen(&mut socket);
            }
            server::swallow(socket.get_ref().try_clone().unwrap());
        })
    };
    let timeouts = Timeouts { ping: MS(100), idle: MS(500), ..LONG };
    let silent = run_on(behaviour(false), |settings| Settings { timeouts, ..settings }, 2);
    assert!(silent.causes.iter().all(|cause| cause.contains("no message")), "{:?}", silent.causes);
    assert_eq!(silent.causes.len(), 2, "it is tried again");
    // The control: pings are answered, and the wait for a chunk ends instead.
    let timeouts = Timeouts { progress: Duration::from_secs(3), ..timeouts };
    let answering = run_on(behaviour(true), |settings| Settings { timeouts, ..settings }, 1);
    assert!(answering.causes[0].contains("no chunk"), "{:?}", answering.causes);
}

#[test]
fn a_connection_cut_in_mid_frame_is_made_again() {
    let outcome = run(Arc::new(|stream, number| {
        let Some(mut socket) = server::websocket(stream) else { return };
        if number >= 2 {
            return server::serve_on(socket, &|key| Some(server::correct(key)));
        }
        server::send(&mut socket, &ServerMessage::Welcome(server::welcome()));
        server::send_raw(&socket, &[0x82, 126, 0x10, 0x00, b'T', b'M']);
    }));
    assert!(outcome.is_complete, "{:?}", outcome.link);
    assert_eq!((outcome.traffic.bad_chunks, outcome.causes.len()), (0, 2), "{:?}", outcome.causes);
}

#[test]
fn floods_end_at_the_credit_or_at_the_surplus() {
    // Chunks of the view, over and over, whatever the credit.
    let chunks = run(Arc::new(|stream, _| {
        let Some(mut socket) = server::websocket(stream) else { return };
        server::send(&mut socket, &ServerMessage::Welcome(server::welcome()));
        let frame = server::correct(far_away());
        while socket.send(Message::Binary(frame.clone())).is_ok() {}
    }));
    assert!(chunks.given_up().contains("neither requested"), "{}", chunks.given_up());
    assert_eq!(chunks.traffic.bad_chunks, u64::from(MAX_BAD));
    let flood = |message: Message| -> Behaviour {
        Arc::new(move |stream, _| {
            let Some(mut socket) = server::websocket(stream) else { return };
            server::send(&mut socket, &ServerMessage::Welcome(server::welcome()));
            while socket.send(message.clone()).is_ok() {}
        })
    };
    let settled = ServerMessage::Settled(Settled { view: 77_777, chunks: u32::MAX });
    let settled = Message::Binary(protocol::control::encode(&settled).unwrap());
    let draining = ServerMessage::Draining { reconnect_after_ms: 1 };
    let draining = Message::Binary(protocol::control::encode(&draining).unwrap());
    for message in [settled, draining, Message::Pong(Bytes::from_static(b"unasked"))] {
        let outcome = run(flood(message));
        assert!(outcome.given_up().contains("without a cause"), "{}", outcome.given_up());
    }
}

#[test]
fn refused_chunks_are_requested_again_with_growing_delays() {
    let fixed = run(server::wrong_at_first(5, |_| None));
    assert!(fixed.is_complete, "{:?}", fixed.link);
    assert_eq!((fixed.traffic.bad_chunks, fixed.traffic.refused_chunks), (0, 5));
    assert!(fixed.traffic.retried_chunks > 0);
    assert_eq!(fixed.last_miss.as_deref(), Some("later?"), "a text of a peer is one line");
    // For ever: the session ends with a reason, and the next one is no better.
    let never = run_short(server::always_wrong(|_| None), 2);
    assert!(never.causes.iter().all(|cause| cause.contains("no chunk")), "{:?}", never.causes);
    assert!(never.traffic.refused_chunks > 0 && never.traffic.retried_chunks > 0);
}

#[test]
fn what_is_no_websocket_is_no_stream() {
    for (answer, without_end, word) in [
        (
            "HTTP/1.1 301 Moved Permanently\r\nLocation: ws://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n",
            "",
            "301",
        ),
        ("\x00\x01\x02 garbage \r\n\r\n", "", "not a Tombolo stream"),
        (
            "HTTP/1.1 101 Switching Protocols\r\n",
            "X-Long: 1234567890123456789012345678901234\r\n",
            "not a Tombolo",
        ),
        (
            "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
             Sec-WebSocket-Accept: AAAA\r\n\r\n",
            "",
            "not a Tombolo stream",
        ),
    ] {
        let outcome = run(Arc::new(move |stream, _| server::answer_http(stream, answer, without_end)));
        assert!(outcome.given_up().contains(word), "{}", outcome.given_up());
    }
}

#[test]
fn absurd_numbers_and_texts_of_a_server_change_nothing() {
    let absurd = Welcome {
        session: u64::MAX,
        world_seed: u64::MAX,
        generator_version: u32::MAX,
        max_credits: 0,
        max_view_distance_m: 0,
        software: "\x1b[2J\n".repeat(40),
        ..server::welcome()
    };
    let draining = ServerMessage::Draining { reconnect_after_ms: u32::MAX };
    let server = HostileServer::start(Arc::new(move |stream, _| {
        let Some(mut socket) = server::websocket(stream) else { return };
        server::send(&mut socket, &ServerMessage::Welcome(absurd.clone()));
        server::send(&mut socket, &draining);
        let _ = socket.close(None);
        server::listen(&mut socket);
    }));
    let settings = Settings { timeouts: LONG, ..Settings::new(server.url().parse().unwrap()) };
    let mut streamer = WorldStreamer::new(ServerStream::connect(settings).unwrap(), CAPACITY);
    let started = Instant::now();
    let mut name = None;
    loop {
        let now = started.elapsed();
        streamer.update(&view(), now, 1, |_| ());
        match streamer.link() {
            Link::Connected(server) => name = Some(server.clone()),
            // 2^32 ms are 50 days.
            Link::Waiting { retry_at, .. } => {
                assert!(*retry_at <= now + Duration::from_secs(60), "{retry_at:?}");
                break;
            }
            _ => {}
        }
        assert!(now < Duration::from_secs(60), "{:?}", streamer.link());
    }
    assert!(name.is_some_and(|name| !name.contains(char::is_control)));
    assert_eq!(streamer.cache().verified_land().map(|(_, digest)| digest), None::<WorldDigest>);
}

#[test]
fn a_shot_from_a_server_of_wrong_chunks_fails_with_one_line() {
    let server = HostileServer::start(server::always_wrong(with_wrong_digest));
    let picture = std::env::temp_dir().join(format!("tombolo-hostile-{}.png", std::process::id()));
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_tombolo-view"))
        .args(["--connect", &server.url(), "--size", "64x36", "--view-distance", "600", "--timeout", "60"])
        .args(["--shot", picture.to_str().unwrap()])
        // Without it, a Vulkan layer of Mesa writes a line to standard error.
        .env("XDG_RUNTIME_DIR", std::env::temp_dir())
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    if errors.contains("mesa-vulkan-drivers") && std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none() {
        eprintln!("SKIPPED: {errors}");
        return;
    }
    assert!(!output.status.success() && !picture.exists());
    assert_eq!(errors.trim_end().lines().count(), 1, "{errors}");
    assert!(errors.contains("8 bad chunks") && errors.contains("digest"), "{errors}");
}
