//! Explicit requests: order, limits, cancellation, load shedding.

use crate::pair::{Pair, next_request, offer, refusals, send, view, welcomed, wire_keys};
use bytes::Bytes;
use protocol::client::Event;
use protocol::message::{ClientMessage, RefusalReason, ServerMessage, WireKey};
use protocol::server::{ChunkRequest, ServerSession};
use protocol::{DataFrame, chunk_codec, control, limits};
use terrain::ChunkKey;

#[test]
fn explicit_requests_come_first_and_invalid_keys_are_refused() {
    let mut pair = Pair::new(64);
    pair.run(0);
    let far = ChunkKey::new(0, 1000, 1000).unwrap();
    pair.client.set_view(view(1, 600));
    pair.client.request(&[far]);
    let request = ClientMessage::Request {
        id: 99,
        keys: vec![WireKey { level: 17, x: 0, z: 0 }, far.into(), WireKey { level: 0, x: i32::MIN, z: 0 }],
    };
    pair.server.receive(DataFrame::Binary(&control::encode(&request).unwrap())).unwrap();
    pair.run(usize::MAX);
    assert_eq!(pair.chunk_keys()[0], far);
    let refused: Vec<_> = pair
        .events
        .iter()
        .filter_map(|event| match event {
            Event::Refused(refused) => Some((refused.id, refused.reason, refused.key.unwrap().level)),
            _ => None,
        })
        .collect();
    assert_eq!(refused, [(99, RefusalReason::OutsideWorld, 17), (99, RefusalReason::OutsideWorld, 0)]);
}

#[test]
fn a_request_beyond_the_limit_is_refused_whole() {
    let mut pair = Pair::new(1);
    pair.run(0);
    let keys: Vec<_> = (0..limits::MAX_KEYS as i32).map(|x| ChunkKey::new(0, x, 0).unwrap()).collect();
    for _ in 0..3 {
        pair.client.request(&keys);
    }
    pair.run(0);
    let refusals = pair.events.iter().filter(|event| matches!(event, Event::Refused(_))).count();
    assert_eq!(refusals, 1, "two requests of 512 fit into 1024, the third does not");
    pair.run(4);
    assert_eq!(pair.chunk_keys().len(), 4);
}

#[test]
fn a_duplicate_key_in_a_request_is_refused_and_sent_once() {
    let mut server = welcomed(64);
    let twice = [wire_keys(3), wire_keys(2)].concat();
    send(&mut server, &ClientMessage::Request { id: 5, keys: twice });
    assert_eq!(refusals(&mut server), [(5, RefusalReason::Duplicate); 2]);
    assert_eq!(std::iter::from_fn(|| next_request(&mut server)).count(), 3);
    // Another request may name the key again, under its own id.
    send(&mut server, &ClientMessage::Request { id: 6, keys: wire_keys(1) });
    assert_eq!(next_request(&mut server).map(|request| request.request), Some(Some(6)));
    assert_eq!(server.counts().refusals[RefusalReason::Duplicate.index()], 2);
}

#[test]
fn a_cancelled_request_is_dropped_and_its_credit_returned() {
    let mut server = welcomed(4);
    send(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(10) });
    send(&mut server, &ClientMessage::Request { id: 2, keys: wire_keys(1) });
    let in_flight: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    send(&mut server, &ClientMessage::Cancel { id: 1 });
    send(&mut server, &ClientMessage::Cancel { id: 77 });
    let stale = server.take_stale();
    assert_eq!(stale.len(), 4);
    assert!(server.take_stale().is_empty(), "each key is returned once");
    // Three are withdrawn; the fourth was generated anyway.
    for request in &in_flight[..3] {
        server.withdraw(*request);
    }
    server.deliver(in_flight[3], Bytes::from_static(b"generated"));
    assert_eq!(server.credits(), 3);
    let left: Vec<_> =
        std::iter::from_fn(|| next_request(&mut server)).map(|request| request.request).collect();
    assert_eq!((left, refusals(&mut server).len()), (vec![Some(2)], 0));
}

#[test]
fn a_request_that_is_cancelled_again_and_again_names_each_chunk_once() {
    let mut server = welcomed(4);
    let request = ClientMessage::Request { id: 1, keys: wire_keys(4) };
    send(&mut server, &request);
    let in_flight: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    (0..1000).for_each(|_| send(&mut server, &ClientMessage::Cancel { id: 1 }));
    assert_eq!(server.take_stale().len(), 4);
    // They are being generated, so they stay in flight.
    send(&mut server, &ClientMessage::Cancel { id: 1 });
    assert!(server.take_stale().is_empty());
    // The control: a new request of the same chunks can be cancelled.
    in_flight.into_iter().for_each(|request| server.withdraw(request));
    send(&mut server, &request);
    assert_eq!(std::iter::from_fn(|| next_request(&mut server)).count(), 4);
    send(&mut server, &ClientMessage::Cancel { id: 1 });
    assert_eq!(server.take_stale().len(), 4);
}

#[test]
fn a_session_has_a_next_chunk_while_one_is_needed_and_there_is_credit() {
    let mut server = welcomed(1);
    assert!(!server.has_next_chunk());
    send(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(2) });
    assert!(server.has_next_chunk());
    let first = next_request(&mut server).unwrap();
    assert!(!server.has_next_chunk(), "no credit");
    server.withdraw(first);
    next_request(&mut server).unwrap();
    send(&mut server, &ClientMessage::Credit { chunks: 1 });
    assert!(!server.has_next_chunk(), "no request");
}

#[test]
fn a_chunk_of_a_second_request_is_not_stale() {
    let mut server = welcomed(4);
    send(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(1) });
    send(&mut server, &ClientMessage::Request { id: 2, keys: wire_keys(1) });
    let in_flight: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    assert_eq!(in_flight.len(), 2);
    for id in [1, 2] {
        send(&mut server, &ClientMessage::Cancel { id });
        assert!(server.take_stale().is_empty(), "another request is in flight");
    }
    server.withdraw(in_flight[0]);
    send(&mut server, &ClientMessage::Cancel { id: 2 });
    assert_eq!(server.take_stale(), [in_flight[1].key]);
}

#[test]
fn a_long_detail_of_a_refusal_is_cut_between_characters() {
    let mut server = welcomed(1);
    send(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(1) });
    let request = next_request(&mut server).unwrap();
    // One byte, and two for each further character: the limit lies inside one.
    let detail = |characters: usize| format!("!{}", "ü".repeat(characters));
    server.fail(request, RefusalReason::Failed, detail(1000));
    let frame = server.poll_transmit().unwrap();
    let Ok(ServerMessage::Refused(refused)) = control::decode(&frame) else { panic!("{frame:?}") };
    assert_eq!(refused.detail, detail((limits::MAX_TEXT - 1) / 2));
}

#[test]
fn shedding_refuses_the_latest_requests_first() {
    let mut server = welcomed(64);
    for id in 0..5 {
        send(&mut server, &ClientMessage::Request { id, keys: wire_keys(2) });
    }
    server.shed(10);
    assert_eq!(server.waiting_requests(), 10);
    server.shed(4);
    let refused = refusals(&mut server);
    assert_eq!(refused.iter().map(|(id, _)| *id).collect::<Vec<_>>(), [4, 4, 3, 3, 2, 2]);
    assert!(refused.iter().all(|(_, reason)| *reason == RefusalReason::Overloaded));
    assert_eq!(server.credits(), 64, "shed requests had taken no credit");
    assert_eq!(std::iter::from_fn(|| next_request(&mut server)).count(), 4);
}

/// A view whose chunks are all in flight for explicit requests, and these.
fn requested_by_a_view_too() -> (ServerSession, Vec<ChunkRequest>) {
    let mut pair = Pair::new(64);
    pair.client.set_view(view(1, 300));
    pair.run(usize::MAX);
    let keys: Vec<WireKey> = pair.chunk_keys().into_iter().map(WireKey::from).collect();
    assert!((2..32).contains(&keys.len()), "{} chunks", keys.len());
    let mut server = welcomed(64);
    send(&mut server, &ClientMessage::Request { id: 7, keys });
    let in_flight: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    send(&mut server, &ClientMessage::View(view(1 << 20, 300)));
    (server, in_flight)
}

/// Delivers what a server requests, by request, until it requests nothing; the view is settled
/// then.
fn delivered(server: &mut ServerSession) -> Vec<Option<u32>> {
    let land = offer().land;
    let requested = std::iter::from_fn(|| {
        let (request, delivery) = server.next_chunk()?;
        let frame = chunk_codec::encode_for(delivery, &land.chunk(request.key), &offer().digest);
        server.deliver(request, frame);
        Some(request.request)
    });
    let requested = requested.collect();
    let is_settled = |frame: Bytes| matches!(control::decode(&frame), Ok(ServerMessage::Settled(_)));
    assert!(std::iter::from_fn(|| server.poll_transmit()).any(is_settled), "the view is not settled");
    requested
}

#[test]
fn a_view_requests_chunks_itself_whose_request_is_cancelled() {
    let (mut server, in_flight) = requested_by_a_view_too();
    send(&mut server, &ClientMessage::Cancel { id: 7 });
    assert_eq!(server.take_stale().len(), in_flight.len(), "the view has not looked at them");
    in_flight.iter().for_each(|request| server.withdraw(*request));
    assert_eq!(server.counts().cancelled, in_flight.len() as u64);
    assert_eq!(delivered(&mut server), vec![None; in_flight.len()]);

    // The view has found them in flight, and waits for them.
    let (mut server, in_flight) = requested_by_a_view_too();
    assert_eq!(next_request(&mut server), None);
    send(&mut server, &ClientMessage::Cancel { id: 7 });
    assert!(server.take_stale().is_empty(), "the view needs them");
    assert_eq!(server.poll_transmit(), None, "nothing is settled");
    for request in &in_flight {
        server.withdraw(*request);
    }
    assert_eq!(delivered(&mut server), vec![None; in_flight.len()]);
}

#[test]
fn a_view_requests_chunks_itself_whose_request_is_refused() {
    let (mut server, in_flight) = requested_by_a_view_too();
    assert_eq!(next_request(&mut server), None);
    for request in &in_flight {
        server.fail(*request, RefusalReason::Overloaded, "too late");
    }
    assert_eq!(refusals(&mut server), vec![(7, RefusalReason::Overloaded); in_flight.len()]);
    // The control: a chunk that fails for the view itself is refused and not requested again.
    let (own, _) = server.next_chunk().unwrap();
    assert_eq!(own.request, None);
    server.fail(own, RefusalReason::Failed, "a fault");
    assert_eq!(refusals(&mut server), [(1 << 20, RefusalReason::Failed)]);
    assert_eq!(delivered(&mut server), vec![None; in_flight.len() - 1]);
}
