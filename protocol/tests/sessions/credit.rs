//! Credit in chunks and bytes.

use crate::pair::{
    Pair, config, next_request, offer, refusals, select_views, send, view, welcome_frame, welcomed, wire_keys,
};
use bytes::Bytes;
use protocol::client::{ClientSession, Event};
use protocol::message::{ClientMessage, RefusalReason};
use protocol::server::Next;
use protocol::{CloseCode, DataFrame, PeerFault, chunk_codec, control, limits};
use terrain::ChunkKey;

#[test]
fn a_server_requests_no_more_chunks_than_credits() {
    let mut pair = Pair::new(5);
    pair.client.set_view(view(1, 1000));
    while let Some(frame) = pair.client.poll_transmit() {
        pair.server.receive(DataFrame::Binary(&frame)).unwrap();
    }
    select_views(&mut pair.server);
    let requested = std::iter::from_fn(|| next_request(&mut pair.server)).count();
    assert_eq!((requested, pair.server.credits()), (5, 0));
}

#[test]
fn a_chunk_beyond_the_granted_credit_is_a_fault() {
    let offer = offer();
    let chunk = chunk_codec::encode(&offer.land.chunk(ChunkKey::new(0, 60, 60).unwrap()), &offer.digest);
    let mut client = ClientSession::new(config(2));
    client.receive(DataFrame::Binary(&welcome_frame())).unwrap();
    while client.poll_transmit().is_some() {}
    for left in [1, 0] {
        assert!(matches!(client.receive(DataFrame::Binary(&chunk)), Ok(Event::Chunk { .. })));
        assert_eq!(client.credits(), left);
    }
    let mut granting = ClientSession::new(config(2));
    granting.receive(DataFrame::Binary(&welcome_frame())).unwrap();
    while granting.poll_transmit().is_some() {}
    granting.receive(DataFrame::Binary(&chunk)).unwrap();
    let grant = granting.poll_transmit().expect("half of the window is used");
    assert_eq!(control::decode(&grant), Ok(ClientMessage::Credit { chunks: 1 }));
    assert_eq!(granting.credits(), 2);

    let fault = client.receive(DataFrame::Binary(&chunk)).unwrap_err();
    assert_eq!((fault.close_code(), fault), (CloseCode::OutOfOrder, PeerFault::CreditOverrun));
}

#[test]
fn a_failed_chunk_returns_its_credit_and_the_view_settles() {
    let mut pair = Pair::new(64);
    pair.client.set_view(view(1, 200));
    pair.run(0);
    while let Some(request) = next_request(&mut pair.server) {
        pair.server.fail(request, RefusalReason::Overloaded, "try later");
    }
    assert_eq!(pair.server.credits(), 64);
    pair.run(0);
    assert_eq!(pair.settled().len(), 1);
}

#[test]
fn reserved_bytes_never_exceed_the_granted_bytes() {
    let mut server = welcomed(64);
    let largest = limits::MAX_CHUNK_FRAME as u32;
    send(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(20) });
    // Before the first grant only chunks are counted.
    let uncounted = next_request(&mut server).unwrap();
    send(&mut server, &ClientMessage::CreditBytes { bytes: 4 * largest });
    let in_flight: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    assert_eq!(in_flight.len(), 3, "one was in flight already");
    // A small frame returns the rest of its reservation.
    server.deliver(uncounted, Bytes::from(vec![0; 1000]));
    assert_eq!(next_request(&mut server), None, "a largest frame less 1000 bytes is not enough");
    server.deliver(in_flight[0], Bytes::from(vec![0; 1000]));
    let next = next_request(&mut server).expect("two give back more than one frame");
    assert_eq!(next_request(&mut server), None);
    // A largest frame returns no bytes, a failed one its whole reservation.
    server.deliver(in_flight[1], Bytes::from(vec![0; largest as usize]));
    assert_eq!(next_request(&mut server), None);
    server.fail(next, RefusalReason::Failed, String::new());
    assert!(next_request(&mut server).is_some());
    send(&mut server, &ClientMessage::CreditBytes { bytes: 10 * largest });
    assert_eq!(std::iter::from_fn(|| next_request(&mut server)).count(), 10);
}

#[test]
fn a_first_grant_below_what_is_in_flight_leaves_a_debt() {
    let mut server = welcomed(64);
    let largest = limits::MAX_CHUNK_FRAME as u32;
    send(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(30) });
    let in_flight: Vec<_> = (0..16).map(|_| next_request(&mut server).unwrap()).collect();
    send(&mut server, &ClientMessage::CreditBytes { bytes: 20_000 });
    assert_eq!(next_request(&mut server), None);
    let (failed, sent) = in_flight.split_at(8);
    for request in failed {
        server.fail(*request, RefusalReason::Failed, "");
    }
    for request in sent {
        server.deliver(*request, Bytes::from(vec![0; 2_000]));
    }
    assert_eq!(next_request(&mut server), None, "16,000 of 20,000 bytes were sent: no largest frame fits");
    send(&mut server, &ClientMessage::CreditBytes { bytes: largest - 4_000 });
    assert!(next_request(&mut server).is_some());
    assert_eq!(next_request(&mut server), None);
}

#[test]
fn a_ready_chunk_costs_the_same_credit_as_a_generated_one() {
    let mut server = welcomed(2);
    send(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(3) });
    let frame = Bytes::from_static(b"ready");
    assert_eq!(server.next_chunk_with(|_, _| Some(frame.clone())), Next::Delivered);
    assert_eq!(server.poll_transmit(), Some(frame.clone()));
    assert!(matches!(server.next_chunk_with(|_, _| None), Next::Generate(..)));
    assert_eq!(server.next_chunk_with(|_, _| Some(frame)), Next::Nothing, "no credit is left");
    assert_eq!((server.counts().chunks, server.credits()), (1, 0));
}

#[test]
fn zero_and_excessive_grants_are_refused_without_effect() {
    let mut server = welcomed(7);
    for chunks in [0, limits::MAX_CREDITS + 1, u32::MAX] {
        send(&mut server, &ClientMessage::Credit { chunks });
    }
    for bytes in [0, limits::MAX_CREDIT_BYTES + 1, u32::MAX] {
        send(&mut server, &ClientMessage::CreditBytes { bytes });
    }
    assert_eq!(refusals(&mut server), [(0, RefusalReason::InvalidCredit); 6]);
    assert_eq!(server.credits(), 7);
    for _ in 0..3 {
        send(&mut server, &ClientMessage::Credit { chunks: limits::MAX_CREDITS });
    }
    assert_eq!((refusals(&mut server).len(), server.credits()), (0, limits::MAX_CREDITS));
}
