//! Streams of valid messages: every message, every extreme, in any order and in any frames. No such
//! stream may end a session, and none may keep the task that accepts connections from its turn,
//! neither alone nor beside peers whose connections fail in all ways.
//!
//! The server runs on one thread here, so that all tasks wait for each other. Time is processor
//! time of that thread: what other programs of the machine do does not count.
//!
//!     TOMBOLO_STREAM_MESSAGES=1000000 cargo test --release -p tombolo-server \
//!         --test message_streams
//!
//! sends so many messages in all; then a turn may take 50 ms at most. `TOMBOLO_STREAM_SEED` chooses
//! other streams, `TOMBOLO_STREAM_REPORT` a file for the figures and bars.
//!
//! | module | content |
//! | --- | --- |
//! | `messages` | random valid messages and frames |
//! | `clients` | sessions that send them and read everything |
//! | `faults` | peers whose connections fail |
//! | `watchdog` | longest time between two turns of a task |
#![cfg(target_os = "linux")]

mod clients;
mod faults;
mod messages;
mod watchdog;

use bars::Bar;
use server::ServerConfig;
use server::mechanism::Mechanism;
use std::time::Duration;

/// Sessions at once.
const SESSIONS: u64 = 16;

/// Peers with faults at once, beside the sessions.
const FAULTY_PEERS: u32 = 16;

/// Messages in all, in `cargo ci`.
const MESSAGES: u64 = 1600;

/// Longest time of a turn in the long form.
const LONGEST_TURN: Duration = Duration::from_millis(50);

/// Messages of the bar.
const REPORTED_MESSAGES: u64 = 1_000_000;

/// How many times as long a turn of the server with a planted blocking handler is, at least.
const CONTROL: u32 = 4;

fn number(name: &str) -> Option<u64> {
    std::env::var(name)
        .ok()
        .map(|text| text.parse().unwrap_or_else(|_| panic!("{name} is no number: {text}")))
}

/// A server of a world of its own: a process remembers the errors of chunks that it measured, and
/// views of the same world would be selected in a fraction of the time.
fn config(world_seed: u64, without: Option<Mechanism>) -> ServerConfig {
    ServerConfig { threads: 1, world_seed, without, ..ServerConfig::default() }
}

/// Sends streams to a server; returns its longest turn. Panics if a session ends.
fn longest_turn(config: ServerConfig, messages: u64, seed: u64, faulty_peers: u32) -> Duration {
    let watched = watchdog::start(config);
    clients::run(watched.address, SESSIONS, messages / SESSIONS, seed, faulty_peers);
    watched.stop()
}

/// Writes the figures of the long form where `TOMBOLO_STREAM_REPORT` says.
fn report(messages: u64, longest: Duration, beside_faults: Duration, blocking: Duration) {
    let Some(path) = std::env::var_os("TOMBOLO_STREAM_REPORT") else { return };
    let ms = |time: Duration| time.as_secs_f64() * 1000.0;
    let bar = ms(LONGEST_TURN);
    // Fewer messages show less than the bar says.
    let of_all = |turn| (messages >= REPORTED_MESSAGES).then(|| ms(turn));
    let bars = [
        Bar::at_most(
            "10^6 valid messages, 16 sessions: longest turn of the accepting thread",
            of_all(longest),
            "ms",
            bar,
        )
        .with_note(
            "processor time between two turns of a task on the thread of all connections; no session \
                 ended",
        ),
        Bar::at_most("the same beside 16 peers with faults", of_all(beside_faults), "ms", bar).with_note(
            "connections that send byte by byte, read nothing, fall silent, and end in a request or in \
                 a message; no other session ended",
        ),
        Bar::at_least("the same, views selected on that thread (control)", Some(ms(blocking)), "ms", bar)
            .with_note(format!("of {MESSAGES} messages, without faults")),
    ];
    std::fs::write(path, serde_json::json!({ "bars": bars }).to_string()).expect("the report");
}

#[test]
fn valid_streams_end_no_session_and_keep_no_task_waiting() {
    let (seed, long) = (number("TOMBOLO_STREAM_SEED").unwrap_or(1), number("TOMBOLO_STREAM_MESSAGES"));
    let messages = long.unwrap_or(MESSAGES);
    let longest = longest_turn(config(1, None), messages, seed, 0);
    println!("{messages} messages of {SESSIONS} sessions: longest turn {longest:?}");
    let beside_faults = longest_turn(config(3, None), messages, seed, FAULTY_PEERS);
    println!("beside {FAULTY_PEERS} peers with faults: longest turn {beside_faults:?}");
    // The control, a handler that blocks: views are selected on the thread of the connections.
    let blocking = longest_turn(config(2, Some(Mechanism::ViewTurns)), MESSAGES, seed, 0);
    println!("with a blocking handler: longest turn {blocking:?}");
    let longest_of_both = longest.max(beside_faults);
    if let Some(messages) = long {
        report(messages, longest, beside_faults, blocking);
        assert!(longest_of_both <= LONGEST_TURN, "{longest:?} and {beside_faults:?}, seed {seed}");
        return;
    }
    assert!(
        blocking >= CONTROL * longest_of_both,
        "{blocking:?} with a blocking handler, {longest:?} and {beside_faults:?} without",
    );
}

#[test]
fn the_generator_makes_every_message_and_valid_ones_only() {
    let mut generator = messages::Generator::new(7);
    let mut kinds = [0; 8];
    for _ in 0..2000 {
        let message = generator.message();
        let bytes = protocol::control::encode(&message).expect("within the limits");
        assert_eq!(protocol::control::decode(&bytes).as_ref(), Ok(&message));
        kinds[messages::kind(&message)] += 1;
    }
    assert!(kinds[1..].iter().all(|count| *count > 50) && kinds[0] == 0, "{kinds:?}");
}
