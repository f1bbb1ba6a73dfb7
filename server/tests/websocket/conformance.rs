//! Runs the tables of `cases` against the echo, and against echoes with a planted fault.

use crate::cases::limits::LIMIT;
use crate::cases::{Case, Group, groups};
use crate::frame::{CLOSE, Frame, parse};
use crate::{echo, echo_server};
use futures_util::{SinkExt, StreamExt};
use server::websocket::socket::WebSocket;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;

/// Bytes of the pipe in each direction: more than any case has.
const PIPE: usize = 4 * LIMIT;

/// Virtual time after which an echo that does not end has failed.
const TEST_TIMEOUT: Duration = Duration::from_secs(60);

/// Runs a case with its bytes written in parts of `part` bytes; an error says what was wrong.
async fn run(case: &Case, part: usize, plant: fn(Frame) -> Option<Frame>) -> Result<(), String> {
    let (client, server) = tokio::io::duplex(PIPE);
    tokio::spawn(echo::serve(WebSocket::new(server, &[], LIMIT), |ping| ping));
    let (mut reader, mut writer) = tokio::io::split(client);
    let bytes: Vec<u8> = case.sent.iter().cloned().filter_map(plant).flat_map(|sent| sent.bytes()).collect();
    let write = async {
        for part in bytes.chunks(part) {
            // The echo may have ended already.
            let _ = writer.write_all(part).await;
            tokio::task::yield_now().await;
        }
    };
    let read = async {
        let mut received = Vec::new();
        let read = tokio::time::timeout(TEST_TIMEOUT, reader.read_to_end(&mut received)).await;
        read.map(|_| received).map_err(|_| "the connection does not end".to_owned())
    };
    let ((), received) = tokio::join!(write, read);
    let mut frames = parse(&received?)?;
    let (opcode, payload) = frames.pop().ok_or("nothing was received")?;
    let code = payload.first_chunk().map(|code| u16::from_be_bytes(*code));
    if (opcode, code) != (CLOSE, Some(case.code)) {
        return Err(format!("ends with opcode {opcode} and code {code:?} instead of {}", case.code));
    }
    if frames != case.received {
        let shown = |frames: &[(u8, Vec<u8>)]| -> Vec<_> {
            frames.iter().take(5).map(|(opcode, payload)| (*opcode, payload.len())).collect()
        };
        return Err(format!(
            "opcodes and lengths {:?} instead of {:?}",
            shown(&frames),
            shown(&case.received)
        ));
    }
    Ok(())
}

/// Runs a group in parts of several sizes. Returns the runs, and what failed.
fn run_group(group: &Group, plant: fn(Frame) -> Option<Frame>) -> (usize, Vec<String>) {
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap();
    let (mut runs, mut failed) = (0, Vec::new());
    for case in &group.cases {
        let bytes: usize = case.sent.iter().map(|frame| frame.payload.len()).sum();
        // Autobahn's parts of 997 bytes, and single bytes where there are not too many.
        for part in [usize::MAX, 997, 1] {
            if part == 1 && bytes > 10_000 {
                continue;
            }
            runs += 1;
            if let Err(error) = runtime.block_on(run(case, part, plant)) {
                failed.push(format!("{}, in parts of {part}: {error}", case.name));
            }
        }
    }
    (runs, failed)
}

#[test]
fn every_case_of_every_group_passes() {
    let mut all_failed = Vec::new();
    for group in groups() {
        let (runs, failed) = run_group(&group, Some);
        println!("{}: {} of {runs}, {} failed", group.name, runs - failed.len(), failed.len());
        all_failed.extend(failed);
    }
    assert!(all_failed.is_empty(), "{all_failed:#?}");
}

#[test]
fn a_planted_fault_is_found_in_every_group() {
    for group in groups() {
        let (runs, failed) = run_group(&group, group.plant);
        println!("{}, {}: {} of {runs} failed", group.name, group.fault, failed.len());
        assert!(!failed.is_empty(), "{}: {}", group.name, group.fault);
    }
}

#[test]
fn names_are_unique_and_every_section_has_cases() {
    let cases: Vec<Case> = groups().into_iter().flat_map(|group| group.cases).collect();
    let names: std::collections::BTreeSet<&str> = cases.iter().map(|case| &case.name[..]).collect();
    assert_eq!(names.len(), cases.len());
    for section in [
        "1.1", "1.2", "2.", "3.", "4.1", "4.2", "5.", "6.2", "6.3", "6.4", "7.1", "7.3", "7.5", "7.7", "7.9",
        "9.",
    ] {
        assert!(names.iter().any(|name| name.starts_with(section)), "{section}");
    }
}

/// Suites of others meet the echo over TCP.
#[tokio::test]
async fn the_echo_answers_over_tcp() {
    let listener = TcpListener::bind(("127.0.0.1", 0)).await.unwrap();
    let url = format!("ws://{}", listener.local_addr().unwrap());
    let server = tokio::spawn(echo_server::run(listener, |ping| ping.get(1..).unwrap_or_default()));
    let (mut socket, _) = connect_async(url).await.unwrap();
    for (sent, answer) in [
        (Message::text("hello"), Message::text("hello")),
        (Message::binary(&b"bytes"[..]), Message::binary(&b"bytes"[..])),
        (Message::Ping("planted".into()), Message::Pong("lanted".into())),
    ] {
        socket.send(sent).await.unwrap();
        let received = tokio::time::timeout(TEST_TIMEOUT, socket.next()).await.unwrap();
        assert_eq!(received.unwrap().unwrap(), answer);
    }
    server.abort();
}
