//! Both session machines against each other, frame by frame, without any transport.
//!
//! | module | what belongs there |
//! | --- | --- |
//! | here | the handshake, views, requests, credit, refusals |
//! | `refined` | frames that refine what came before |

mod pair;
mod refined;

use bytes::Bytes;
use pair::{Pair, config, next_wanted, offer, select_views, view};
use proptest::prelude::*;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::message::{ClientMessage, Hello, RefusalReason, Rejection, ServerMessage, WireKey};
use protocol::server::{ServerOffer, ServerSession};
use protocol::view::View;
use protocol::{
    ChunkError, CloseCode, ControlError, Delivery, Incoming, PROTOCOL_VERSION, PeerFault, Tolerance,
    chunk_codec, control, limits,
};
use std::collections::HashSet;
use terrain::{Chunk, ChunkKey, Land, WorldDigest};

#[test]
fn a_view_is_delivered_whole_once_and_settled() {
    let mut pair = Pair::new(8);
    pair.client.set_view(view(7, 1000));
    pair.run(usize::MAX);
    assert!(matches!(pair.events[0], Event::Welcome(_)));
    let keys = pair.chunk_keys();
    let unique: HashSet<_> = keys.iter().collect();
    assert_eq!(unique.len(), keys.len());
    assert_eq!(pair.settled(), [(7, keys.len() as u32)]);
    assert!(keys.len() > 16, "several windows were needed: {}", keys.len());
}

fn seed_only(window: u32) -> ClientConfig {
    ClientConfig { delivery: Delivery::SeedOnly, ..config(window) }
}

/// All chunks of a view with the bytes that they came as, by key.
fn received(config: ClientConfig) -> (Vec<Chunk>, usize) {
    let delivery = config.delivery;
    let mut pair = Pair::with(config);
    pair.client.set_view(view(1, 1000));
    pair.run(usize::MAX);
    let mut total = 0;
    let mut chunks = Vec::new();
    for event in pair.events {
        if let Event::Chunk { chunk, bytes, delivery: came } = event {
            assert_eq!(came, delivery);
            total += bytes;
            chunks.push(*chunk);
        }
    }
    let counts = pair.server.counts();
    assert_eq!((counts.chunks, counts.chunk_bytes), (chunks.len() as u64, total as u64));
    chunks.sort_by_key(|chunk| chunk.key);
    (chunks, total)
}

#[test]
fn both_deliveries_bring_equal_chunks_and_seed_only_36_bytes_each() {
    let (exact, exact_bytes) = received(config(64));
    let (seed, seed_bytes) = received(seed_only(64));
    assert!(exact == seed && exact.len() > 16);
    assert_eq!(seed_bytes, limits::SEED_ONLY_FRAME * seed.len());
    assert!(exact_bytes > 20 * seed_bytes, "{exact_bytes} against {seed_bytes}");
    // The control: another world's chunks are not equal.
    let other = Land::new(2);
    assert!(seed.iter().any(|chunk| *chunk != other.chunk(chunk.key)));
}

/// What a welcomed client says to one chunk frame.
fn verdict(config: ClientConfig, frame: &[u8]) -> Result<Event, PeerFault> {
    let mut client = ClientSession::new(config);
    client.receive(Incoming::Binary(&welcome_frame())).unwrap();
    client.receive(Incoming::Binary(frame))
}

#[test]
fn a_lying_seed_only_frame_is_noticed_and_an_honest_one_is_not() {
    let ServerOffer { land, digest, .. } = offer();
    let key = ChunkKey::new(0, 3, -7).unwrap();
    let honest = land.chunk(key);
    let frame = chunk_codec::encode_for(Delivery::SeedOnly, &honest, &digest);
    assert!(matches!(verdict(seed_only(4), &frame), Ok(Event::Chunk { chunk, .. }) if *chunk == honest));

    let mut heights = honest.heights.clone();
    heights[2000] += 1;
    let lie = Chunk::from_parts(key, heights, honest.error, honest.grass);
    let frame = chunk_codec::encode_for(Delivery::SeedOnly, &lie, &digest);
    let fault = verdict(seed_only(4), &frame).unwrap_err();
    assert_eq!((fault.close_code(), fault), (CloseCode::Malformed, ChunkError::Regenerated(key).into()));
}

#[test]
fn an_exact_frame_may_come_in_every_delivery_and_a_seed_only_one_only_where_it_was_asked_for() {
    let ServerOffer { land, digest, .. } = offer();
    let chunk = land.chunk(ChunkKey::new(0, 3, -7).unwrap());
    let [exact, seed] = [Delivery::Exact, Delivery::SeedOnly]
        .map(|delivery| chunk_codec::encode_for(delivery, &chunk, &digest));
    let came = |config, frame: &[u8]| match verdict(config, frame) {
        Ok(Event::Chunk { delivery, .. }) => Ok(delivery),
        Ok(other) => panic!("{other:?}"),
        Err(fault) => Err(fault),
    };
    assert_eq!(came(seed_only(4), &exact), Ok(Delivery::Exact));
    assert_eq!(came(seed_only(4), &seed), Ok(Delivery::SeedOnly));
    assert_eq!(came(config(4), &exact), Ok(Delivery::Exact));
    assert_eq!(came(config(4), &seed), Err(ChunkError::UnknownKind(chunk_codec::KIND_SEED_ONLY).into()));
}

#[test]
fn a_client_that_generates_another_world_refuses_seed_only_delivery_with_both_digests() {
    // The server's generator differs: its seed makes another world here.
    let (ours, theirs) = (Land::new(1).digest(), WorldDigest([0xcd; 32]));
    let welcome = |config: ClientConfig| {
        let mut client = ClientSession::new(config);
        let mut server = ServerSession::new(ServerOffer { digest: theirs, ..offer() }, 1);
        server.receive(Incoming::Binary(&client.poll_transmit().unwrap())).unwrap();
        client.receive(Incoming::Binary(&server.poll_transmit().unwrap()))
    };
    let fault = welcome(seed_only(1)).unwrap_err();
    assert_eq!(fault.close_code(), CloseCode::WrongWorld);
    let text = fault.to_string();
    assert!(text.contains(&ours.to_string()) && text.contains(&theirs.to_string()), "{text}");
    assert!(text.contains("use exact delivery") && text.lines().count() == 1, "{text}");
    // The control: exact delivery needs no generator.
    assert!(matches!(welcome(config(1)), Ok(Event::Welcome(_))));
}

#[test]
fn coarse_chunks_come_before_their_children() {
    let mut pair = Pair::new(64);
    pair.client.set_view(view(1, 1000));
    pair.run(usize::MAX);
    let keys = pair.chunk_keys();
    for (index, key) in keys.iter().enumerate() {
        let parent = key.parent().unwrap();
        assert!(keys[index..].iter().all(|later| *later != parent), "{parent} came after its child {key}");
    }
}

#[test]
fn the_same_view_again_sends_nothing_new_and_settles_again() {
    let mut pair = Pair::new(64);
    pair.client.set_view(view(1, 600));
    pair.run(usize::MAX);
    let before = pair.delivered;
    pair.client.set_view(view(2, 600));
    pair.run(usize::MAX);
    assert_eq!(pair.delivered, before);
    assert_eq!(pair.settled().last().unwrap().0, 2);
}

#[test]
fn released_chunks_are_sent_again_and_held_chunks_are_not() {
    let mut pair = Pair::new(64);
    pair.client.set_view(view(1, 600));
    pair.run(usize::MAX);
    let keys = pair.chunk_keys();
    pair.client.release(&keys[..3]);
    pair.client.set_view(view(2, 600));
    pair.run(usize::MAX);
    assert_eq!(pair.delivered, keys.len() + 3);

    let mut resumed = Pair::new(64);
    resumed.client.holding(&keys);
    resumed.client.set_view(view(1, 600));
    resumed.run(usize::MAX);
    assert_eq!((resumed.delivered, resumed.settled()), (0, vec![(1, keys.len() as u32)]));
}

#[test]
fn a_server_never_owes_more_than_the_credits() {
    let mut pair = Pair::new(5);
    pair.client.set_view(view(1, 1000));
    while let Some(frame) = pair.client.poll_transmit() {
        pair.server.receive(Incoming::Binary(&frame)).unwrap();
    }
    select_views(&mut pair.server);
    let asked = std::iter::from_fn(|| next_wanted(&mut pair.server)).count();
    assert_eq!((asked, pair.server.credits()), (5, 0));
}

#[test]
fn a_chunk_beyond_the_granted_credit_is_a_fault_and_a_new_grant_admits_again() {
    let offer = offer();
    let chunk = chunk_codec::encode(&offer.land.chunk(ChunkKey::new(0, 60, 60).unwrap()), &offer.digest);
    let mut client = ClientSession::new(config(2));
    client.receive(Incoming::Binary(&welcome_frame())).unwrap();
    while client.poll_transmit().is_some() {}
    for left in [1, 0] {
        assert!(matches!(client.receive(Incoming::Binary(&chunk)), Ok(Event::Chunk { .. })));
        assert_eq!(client.credits(), left);
    }
    let mut patient = ClientSession::new(config(2));
    patient.receive(Incoming::Binary(&welcome_frame())).unwrap();
    while patient.poll_transmit().is_some() {}
    patient.receive(Incoming::Binary(&chunk)).unwrap();
    let grant = patient.poll_transmit().expect("half of the window is used");
    assert_eq!(control::decode(&grant), Ok(ClientMessage::Credit { chunks: 1 }));
    assert_eq!(patient.credits(), 2);

    let fault = client.receive(Incoming::Binary(&chunk)).unwrap_err();
    assert_eq!((fault.close_code(), fault), (CloseCode::OutOfOrder, PeerFault::CreditOverrun));
}

fn welcome_frame() -> Bytes {
    let mut server = ServerSession::new(offer(), 1);
    let hello = ClientMessage::Hello(Hello {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: String::new(),
    });
    server.receive(Incoming::Binary(&control::encode(&hello).unwrap())).unwrap();
    server.poll_transmit().unwrap()
}

#[test]
fn explicit_requests_come_first_and_bad_keys_are_refused_one_by_one() {
    let mut pair = Pair::new(64);
    pair.run(0);
    let far = ChunkKey::new(0, 1000, 1000).unwrap();
    pair.client.set_view(view(1, 600));
    pair.client.request(&[far]);
    let request = ClientMessage::Request {
        id: 99,
        keys: vec![WireKey { level: 17, x: 0, z: 0 }, far.into(), WireKey { level: 0, x: i32::MIN, z: 0 }],
    };
    pair.server.receive(Incoming::Binary(&control::encode(&request).unwrap())).unwrap();
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
fn too_many_requests_are_refused_whole_without_harm() {
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
fn an_absurd_view_is_refused_and_the_session_goes_on() {
    let mut pair = Pair::new(64);
    pair.client.set_view(View { fov_mdeg: 0, ..view(3, 600) });
    pair.client.set_view(View { distance_m: u32::MAX, ..view(4, 600) });
    pair.client.set_view(view(5, 600));
    pair.run(usize::MAX);
    let refused =
        |event: &&Event| matches!(event, Event::Refused(r) if r.reason == RefusalReason::InvalidView);
    assert_eq!(pair.events.iter().filter(refused).count(), 2);
    assert_eq!(pair.settled()[0].0, 5);
}

#[test]
fn a_failed_chunk_returns_its_credit_and_lets_the_view_settle() {
    let mut pair = Pair::new(64);
    pair.client.set_view(view(1, 200));
    pair.run(0);
    while let Some(wanted) = next_wanted(&mut pair.server) {
        pair.server.fail(wanted, RefusalReason::Overloaded, "try later");
    }
    assert_eq!(pair.server.credits(), 64);
    pair.run(0);
    assert_eq!(pair.settled().len(), 1);
}

#[test]
fn quantised_frames_come_only_to_who_asked_and_no_coarser_than_asked() {
    let (land, world) = (Land::new(1), offer().digest);
    let chunk = land.chunk(ChunkKey::new(0, 3, -7).unwrap());
    let [fine, asked, coarse] = [4, 8, 16].map(|units| Tolerance::new(units).unwrap());
    let receive = |delivery, sent| {
        let mut client = ClientSession::new(ClientConfig { delivery, ..config(4) });
        client.receive(Incoming::Binary(&welcome_frame())).unwrap();
        let frame = chunk_codec::encode_for(sent, &chunk, &world);
        client.receive(Incoming::Binary(&frame))
    };
    for sent in [Delivery::Quantised(asked), Delivery::Quantised(fine), Delivery::Exact] {
        let Ok(Event::Chunk { chunk: got, delivery, .. }) = receive(Delivery::Quantised(asked), sent) else {
            panic!("{sent} was refused");
        };
        assert_eq!(delivery, sent);
        assert_eq!(*got == chunk, sent == Delivery::Exact);
    }
    let fault = receive(Delivery::Quantised(asked), Delivery::Quantised(coarse)).unwrap_err();
    assert_eq!(fault, ChunkError::Tolerance { theirs: 16, ours: 8 }.into());
    for delivery in [Delivery::Exact, Delivery::SeedOnly] {
        let fault = receive(delivery, Delivery::Quantised(fine)).unwrap_err();
        assert_eq!(fault, ChunkError::UnknownKind(chunk_codec::KIND_QUANTISED).into(), "{delivery}");
    }
}

#[test]
fn handshakes_that_cannot_succeed_name_both_sides() {
    let wrong = WorldDigest([9; 32]);
    let mut client = ClientSession::new(ClientConfig { digest: Some(wrong), ..config(1) });
    let mut server = ServerSession::new(offer(), 1);
    let fault = server.receive(Incoming::Binary(&client.poll_transmit().unwrap())).unwrap_err();
    assert_eq!(fault.close_code(), CloseCode::WrongWorld);
    let seen = client.receive(Incoming::Binary(&server.poll_transmit().unwrap())).unwrap_err();
    assert_eq!(seen, fault);
    let text = seen.to_string();
    assert!(text.contains(&wrong.to_string()) && text.contains(&offer().digest.to_string()), "{text}");

    let mut frame = control::encode(&ClientMessage::Credit { chunks: 1 }).unwrap().to_vec();
    frame[4] = 77;
    let mut server = ServerSession::new(offer(), 1);
    let fault = server.receive(Incoming::Binary(&frame)).unwrap_err();
    assert_eq!(fault, PeerFault::Rejected(Rejection::WrongVersion { client: 77, server: PROTOCOL_VERSION }));
    let ours = format!("server {PROTOCOL_VERSION}");
    assert!(fault.to_string().contains("77") && fault.to_string().contains(&ours));
}

#[test]
fn a_token_is_required_where_it_is_set_and_only_the_right_one_admits() {
    for (presented, admitted) in
        [(None, false), (Some("wrong"), false), (Some(""), false), (Some("secret"), true)]
    {
        let mut server = ServerSession::new(ServerOffer { token: Some("secret".into()), ..offer() }, 1);
        let config = ClientConfig { token: presented.map(String::from), ..config(1) };
        let hello = ClientSession::new(config).poll_transmit().unwrap();
        let result = server.receive(Incoming::Binary(&hello));
        assert_eq!(result.is_ok(), admitted, "{presented:?}");
        assert_eq!(server.is_welcomed(), admitted);
    }
}

#[test]
fn order_is_enforced_on_both_sides() {
    let mut server = ServerSession::new(offer(), 1);
    let view = control::encode(&ClientMessage::View(view(1, 600))).unwrap();
    assert!(matches!(server.receive(Incoming::Binary(&view)), Err(PeerFault::OutOfOrder(_))));
    assert!(matches!(server.receive(Incoming::Text), Err(PeerFault::Text)));

    let mut client = ClientSession::new(config(1));
    let settled = control::encode(&ServerMessage::Settled { view: 1, chunks: 1 }).unwrap();
    assert!(matches!(client.receive(Incoming::Binary(&settled)), Err(PeerFault::OutOfOrder(_))));
    let chunk = chunk_codec::encode(&Land::new(1).chunk(ChunkKey::new(0, 60, 60).unwrap()), &offer().digest);
    assert!(matches!(client.receive(Incoming::Binary(&chunk)), Err(PeerFault::OutOfOrder(_))));
    let welcome = welcome_frame();
    client.receive(Incoming::Binary(&welcome)).unwrap();
    assert!(matches!(client.receive(Incoming::Binary(&welcome)), Err(PeerFault::OutOfOrder(_))));
    assert!(matches!(
        client.receive(Incoming::Binary(&chunk[..40])),
        Err(PeerFault::Chunk(ChunkError::Truncated { .. }))
    ));
}

#[test]
fn every_truncation_and_one_extra_byte_of_every_control_frame_is_refused() {
    let keys = vec![WireKey { level: 1, x: 2, z: 3 }; 4];
    let messages = [
        ClientMessage::Hello(Hello {
            digest: Some([1; 32]),
            delivery: Delivery::SeedOnly,
            token: Some("t".into()),
            software: "s".into(),
        }),
        ClientMessage::View(view(1, 1)),
        ClientMessage::Credit { chunks: 1 },
        ClientMessage::Request { id: 1, keys: keys.clone() },
        ClientMessage::Release { keys: keys.clone() },
        ClientMessage::Holding { keys },
        ClientMessage::CreditBytes { bytes: 1 },
        ClientMessage::Cancel { id: 1 },
    ];
    for message in messages {
        let frame = control::encode(&message).unwrap();
        assert_eq!(control::decode::<ClientMessage>(&frame), Ok(message));
        for length in 0..frame.len() {
            assert!(control::decode::<ClientMessage>(&frame[..length]).is_err(), "{length}");
        }
        let longer = [&frame[..], &[0]].concat();
        assert_eq!(control::decode::<ClientMessage>(&longer), Err(ControlError::Trailing(1)));
    }
}

#[test]
fn a_list_length_beyond_the_frame_is_refused_without_allocating_it() {
    let mut frame = control::encode(&ClientMessage::Release { keys: Vec::new() }).unwrap().to_vec();
    let length_at = frame.len() - 8;
    for length in [u64::MAX, 1 << 40, limits::MAX_KEYS as u64 + 1, 1] {
        frame[length_at..].copy_from_slice(&length.to_le_bytes());
        assert!(control::decode::<ClientMessage>(&frame).is_err(), "{length}");
    }
    let keys = vec![WireKey { level: 0, x: 0, z: 0 }; limits::MAX_KEYS + 1];
    assert_eq!(
        control::encode(&ClientMessage::Release { keys }),
        Err(ControlError::TooManyKeys(limits::MAX_KEYS + 1))
    );
    assert!(matches!(
        control::decode::<ClientMessage>(&[0; limits::MAX_CONTROL_FRAME + 1]),
        Err(ControlError::TooLong(_))
    ));
}

/// Says something to a server as it stands on the wire.
fn say(server: &mut ServerSession, message: &ClientMessage) {
    server.receive(Incoming::Binary(&control::encode(message).unwrap())).unwrap();
    select_views(server);
}

/// A welcomed server with credit for so many chunks, and nothing left to send.
fn welcomed(credits: u32) -> ServerSession {
    let mut server = ServerSession::new(offer(), 1);
    let mut client = ClientSession::new(config(credits));
    while let Some(frame) = client.poll_transmit() {
        server.receive(Incoming::Binary(&frame)).unwrap();
    }
    while server.poll_transmit().is_some() {}
    server
}

fn wire_keys(count: i32) -> Vec<WireKey> {
    (0..count).map(|x| WireKey { level: 0, x, z: 0 }).collect()
}

/// The refusals that a server has to say, by id and reason.
fn refusals(server: &mut ServerSession) -> Vec<(u32, RefusalReason)> {
    let refused = |frame: Bytes| match control::decode(&frame) {
        Ok(ServerMessage::Refused(refused)) => Some((refused.id, refused.reason)),
        _ => None,
    };
    std::iter::from_fn(|| server.poll_transmit()).filter_map(refused).collect()
}

#[test]
fn bytes_owed_never_exceed_the_bytes_granted_whatever_frames_turn_out_to_be() {
    let mut server = welcomed(64);
    let largest = limits::MAX_CHUNK_FRAME as u32;
    say(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(20) });
    // Before the first grant only chunks are counted.
    let uncounted = next_wanted(&mut server).unwrap();
    say(&mut server, &ClientMessage::CreditBytes { bytes: 4 * largest });
    let under_way: Vec<_> = std::iter::from_fn(|| next_wanted(&mut server)).collect();
    assert_eq!(under_way.len(), 3, "one was under way already");
    // A small frame gives back what was reserved for a large one.
    server.deliver(uncounted, Bytes::from(vec![0; 1000]));
    assert_eq!(next_wanted(&mut server), None, "a largest frame less 1000 bytes is not enough");
    server.deliver(under_way[0], Bytes::from(vec![0; 1000]));
    let next = next_wanted(&mut server).expect("two give back more than one frame");
    assert_eq!(next_wanted(&mut server), None);
    // A largest frame gives nothing back, a failed one everything.
    server.deliver(under_way[1], Bytes::from(vec![0; largest as usize]));
    assert_eq!(next_wanted(&mut server), None);
    server.fail(next, RefusalReason::Failed, String::new());
    assert!(next_wanted(&mut server).is_some());
    say(&mut server, &ClientMessage::CreditBytes { bytes: 10 * largest });
    assert_eq!(std::iter::from_fn(|| next_wanted(&mut server)).count(), 10);
}

#[test]
fn a_ready_chunk_costs_the_same_credit_as_one_that_is_made() {
    use protocol::server::Next;
    let mut server = welcomed(2);
    say(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(3) });
    let frame = Bytes::from_static(b"ready");
    assert_eq!(server.next_chunk_with(|_, _| Some(frame.clone())), Next::Delivered);
    assert_eq!(server.poll_transmit(), Some(frame.clone()));
    assert!(matches!(server.next_chunk_with(|_, _| None), Next::Make(..)));
    assert_eq!(server.next_chunk_with(|_, _| Some(frame)), Next::Nothing, "no credit is left");
    assert_eq!((server.counts().chunks, server.credits()), (1, 0));
}

#[test]
fn a_key_named_twice_in_one_request_is_refused_once_and_sent_once() {
    let mut server = welcomed(64);
    let twice = [wire_keys(3), wire_keys(2)].concat();
    say(&mut server, &ClientMessage::Request { id: 5, keys: twice });
    assert_eq!(refusals(&mut server), [(5, RefusalReason::Duplicate); 2]);
    assert_eq!(std::iter::from_fn(|| next_wanted(&mut server)).count(), 3);
    // Another request may ask again: it has an id of its own to be answered under.
    say(&mut server, &ClientMessage::Request { id: 6, keys: wire_keys(1) });
    assert_eq!(next_wanted(&mut server).map(|wanted| wanted.request), Some(Some(6)));
    assert_eq!(server.counts().refusals[RefusalReason::Duplicate.index()], 2);
}

#[test]
fn grants_of_nothing_and_absurd_ones_are_refused_and_change_nothing() {
    let mut server = welcomed(7);
    for chunks in [0, limits::MAX_CREDITS + 1, u32::MAX] {
        say(&mut server, &ClientMessage::Credit { chunks });
    }
    for bytes in [0, limits::MAX_CREDIT_BYTES + 1, u32::MAX] {
        say(&mut server, &ClientMessage::CreditBytes { bytes });
    }
    assert_eq!(refusals(&mut server), [(0, RefusalReason::InvalidCredit); 6]);
    assert_eq!(server.credits(), 7);
    for _ in 0..3 {
        say(&mut server, &ClientMessage::Credit { chunks: limits::MAX_CREDITS });
    }
    assert_eq!((refusals(&mut server).len(), server.credits()), (0, limits::MAX_CREDITS));
}

#[test]
fn a_cancelled_request_is_neither_made_nor_refused_and_its_credit_comes_back() {
    let mut server = welcomed(4);
    say(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(10) });
    say(&mut server, &ClientMessage::Request { id: 2, keys: wire_keys(1) });
    let under_way: Vec<_> = std::iter::from_fn(|| next_wanted(&mut server)).collect();
    say(&mut server, &ClientMessage::Cancel { id: 1 });
    say(&mut server, &ClientMessage::Cancel { id: 77 });
    let stale = server.take_stale();
    assert_eq!(stale.len(), 4);
    assert!(server.take_stale().is_empty(), "told once");
    // Three can be stopped; the fourth was made all the same.
    for wanted in &under_way[..3] {
        server.withdraw(*wanted);
    }
    server.deliver(under_way[3], Bytes::from_static(b"made"));
    assert_eq!(server.credits(), 3);
    let left: Vec<_> = std::iter::from_fn(|| next_wanted(&mut server)).map(|wanted| wanted.request).collect();
    assert_eq!((left, refusals(&mut server).len()), (vec![Some(2)], 0));
}

#[test]
fn a_chunk_that_a_second_request_waits_for_is_not_stale() {
    let mut server = welcomed(4);
    say(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(1) });
    say(&mut server, &ClientMessage::Request { id: 2, keys: wire_keys(1) });
    assert_eq!(std::iter::from_fn(|| next_wanted(&mut server)).count(), 2);
    say(&mut server, &ClientMessage::Cancel { id: 1 });
    assert!(server.take_stale().is_empty());
}

#[test]
fn what_an_old_view_wanted_and_the_next_does_not_is_stale() {
    let mut server = welcomed(8);
    say(&mut server, &ClientMessage::View(view(1, 300)));
    let under_way: Vec<_> = std::iter::from_fn(|| next_wanted(&mut server)).collect();
    assert_eq!(under_way.len(), 8);
    // The same place again: all of it is still wanted.
    say(&mut server, &ClientMessage::View(view(2, 300)));
    assert!(server.take_stale().is_empty());
    say(&mut server, &ClientMessage::View(View { eye: [1 << 29, 25_600, 1 << 29], ..view(3, 300) }));
    let stale: HashSet<_> = server.take_stale().into_iter().collect();
    assert_eq!(stale, under_way.iter().map(|wanted| wanted.key).collect());
}

#[test]
fn a_moving_view_is_settled_before_anything_ahead_is_sent_and_what_lies_ahead_comes_then() {
    let moving = |id, metres: i32| View {
        eye: [metres * 256, 25_600, 0],
        velocity: [150 * 256, 0, 0],
        ..view(id, 600)
    };
    let mut pair = Pair::new(64);
    pair.client.set_view(moving(1, 0));
    pair.run(usize::MAX);
    let (_, needed) = pair.settled()[0];
    let settled_at = pair.events.iter().position(|event| matches!(event, Event::Settled { .. })).unwrap();
    let before =
        pair.events[..settled_at].iter().filter(|event| matches!(event, Event::Chunk { .. })).count();
    assert_eq!(before, needed as usize);
    assert!(pair.delivered > before, "nothing was sent ahead");
    // Two seconds later everything is there already.
    let sent = pair.delivered;
    pair.client.set_view(View { velocity: [0; 3], ..moving(2, 300) });
    pair.run(usize::MAX);
    assert_eq!((pair.delivered, pair.settled().len()), (sent, 2));
    // The control: without a velocity it is not.
    let mut still = Pair::new(64);
    still.client.set_view(View { velocity: [0; 3], ..moving(1, 0) });
    still.run(usize::MAX);
    let sent = still.delivered;
    still.client.set_view(View { velocity: [0; 3], ..moving(2, 300) });
    still.run(usize::MAX);
    assert!(still.delivered > sent);
}

#[test]
fn only_the_newest_queued_view_is_selected_and_none_while_another_is() {
    let mut server = welcomed(64);
    let receive = |server: &mut ServerSession, id| {
        let message = ClientMessage::View(view(id, 300));
        server.receive(Incoming::Binary(&control::encode(&message).unwrap())).unwrap();
    };
    (1..=1000).for_each(|id| receive(&mut server, id));
    let selection = server.take_view().unwrap();
    assert_eq!(selection.view().id, 1000);
    (1001..=1003).for_each(|id| receive(&mut server, id));
    assert!(server.take_view().is_none() && server.has_queued_view(), "one selection at a time");
    server.apply_view(selection);
    assert_eq!(server.view().map(|view| view.id), Some(1000));
    let selection = server.take_view().unwrap();
    assert_eq!(selection.view().id, 1003);
    server.apply_view(selection);
    assert!(server.take_view().is_none() && !server.has_queued_view());
    let counts = server.counts();
    assert_eq!((counts.views, counts.superseded_views), (2, 1001));
}

#[test]
fn a_selection_in_steps_finds_what_one_in_one_piece_finds() {
    let moving = View { velocity: [150 * 256, 0, 0], ..view(1, 2000) };
    let mut found = Vec::new();
    for chunks in [1, 50, usize::MAX] {
        let mut server = welcomed(4096);
        server
            .receive(Incoming::Binary(&control::encode(&ClientMessage::View(moving)).unwrap()))
            .unwrap();
        let mut selection = server.take_view().unwrap();
        let mut steps = 1;
        while !selection.step(&offer().land, chunks) {
            steps += 1;
        }
        assert!(chunks > 50 || steps > 10, "{steps} steps");
        server.apply_view(selection);
        found.push(std::iter::from_fn(|| next_wanted(&mut server)).collect::<Vec<_>>());
    }
    assert!(found[0].len() > 30 && found[0] == found[1] && found[1] == found[2]);
}

#[test]
fn a_view_of_too_many_chunks_is_refused_and_changes_nothing() {
    let largest = View { viewport: [limits::MAX_VIEWPORT; 2], tolerance_q4: 1, ..view(2, 65_536) };
    let mut server = welcomed(64);
    say(&mut server, &ClientMessage::View(view(1, 300)));
    say(&mut server, &ClientMessage::View(largest));
    assert_eq!(refusals(&mut server), [(2, RefusalReason::InvalidView)]);
    assert_eq!(server.view().map(|view| view.id), Some(1));
    // The control: views that viewers send, up to a picture of 3840 x 2160 at half a pixel and 20
    // km.
    for (distance_m, viewport, tolerance_q4) in [(8000, [1920, 1080], 16), (20_000, [3840, 2160], 8)] {
        say(&mut server, &ClientMessage::View(View { viewport, tolerance_q4, ..view(3, distance_m) }));
    }
    assert_eq!((refusals(&mut server), server.counts().views), (vec![], 3));
}

#[test]
fn shedding_refuses_the_latest_requests_and_keeps_the_first() {
    let mut server = welcomed(64);
    for id in 0..5 {
        say(&mut server, &ClientMessage::Request { id, keys: wire_keys(2) });
    }
    server.shed(10);
    assert_eq!(server.waiting_requests(), 10);
    server.shed(4);
    let refused = refusals(&mut server);
    assert_eq!(refused.iter().map(|(id, _)| *id).collect::<Vec<_>>(), [4, 4, 3, 3, 2, 2]);
    assert!(refused.iter().all(|(_, reason)| *reason == RefusalReason::Overloaded));
    assert_eq!(server.credits(), 64, "what was shed had taken no credit");
    assert_eq!(std::iter::from_fn(|| next_wanted(&mut server)).count(), 4);
}

#[test]
fn the_wildest_numbers_of_a_view_are_refused_or_served_and_never_panic() {
    for extreme in [i32::MIN, -1, 0, 1, i32::MAX] {
        let mut server = welcomed(4);
        for eye in [[0; 3], [1 << 30, extreme, -(1 << 30)], [extreme; 3]] {
            say(
                &mut server,
                &ClientMessage::View(View {
                    eye,
                    velocity: [extreme; 3],
                    yaw_mdeg: extreme,
                    pitch_mdeg: extreme,
                    ..view(1, 65_536)
                }),
            );
        }
        while next_wanted(&mut server).is_some() {}
        let counts = server.counts();
        assert_eq!(counts.views + counts.refusals[RefusalReason::InvalidView.index()], 3);
    }
}

proptest! {
    #[test]
    fn garbage_panics_neither_session(frames in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..80), 1..8),
                                      framing in 0usize..4) {
        // Bare, as a control frame, as each kind of chunk frame.
        let start = [&b""[..], b"TMBM\x03\x00", b"TMBC\x01\x00\x00", b"TMBC\x01\x00\x01"][framing];
        for config in [config(4), seed_only(4)] {
            let mut server = ServerSession::new(offer(), 1);
            let mut client = ClientSession::new(config);
            server.receive(Incoming::Binary(&client.poll_transmit().unwrap())).unwrap();
            client.receive(Incoming::Binary(&server.poll_transmit().unwrap())).unwrap();
            for frame in &frames {
                let frame = [start, frame].concat();
                let _ = server.receive(Incoming::Binary(&frame));
                let _ = client.receive(Incoming::Binary(&frame));
                select_views(&mut server);
                while next_wanted(&mut server).is_some() {}
            }
        }
    }
}
