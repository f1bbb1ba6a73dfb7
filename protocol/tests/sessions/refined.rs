//! Refined frames: exact heights, and only while the parent is in the reference window.

use crate::pair::{Pair, config, offer, view};
use protocol::chunk_codec::{self, Effort, refined, seed_only};
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::limits::{CHUNK_HEADER, MAX_CREDITS, MAX_REFERENCES};
use protocol::message::{ClientMessage, Hello, ServerMessage, Welcome};
use protocol::server::ServerSession;
use protocol::{ChunkError, DataFrame, Delivery, PeerFault, control};
use std::collections::{HashMap, HashSet};
use terrain::constants::GENERATOR_VERSION;
use terrain::{ChunkKey, Land};

fn refined_config(window: u32) -> ClientConfig {
    ClientConfig { delivery: Delivery::Refined, ..config(window) }
}

fn key(level: u8, x: i32, z: i32) -> ChunkKey {
    ChunkKey::new(level, x, z).unwrap()
}

/// Bytes of all chunks of a view, and the number of refined and of all frames. Every chunk must
/// equal the land's.
fn received(config: ClientConfig) -> (usize, usize, usize) {
    let mut pair = Pair::with(config);
    pair.client.set_view(view(1, 1500));
    pair.run(usize::MAX);
    let (mut total, mut refined, mut count) = (0, 0, 0);
    for event in &pair.events {
        let Event::Chunk { chunk, bytes, delivery } = event else { continue };
        assert_eq!(**chunk, pair.land.chunk(chunk.key));
        total += bytes;
        count += 1;
        refined += usize::from(*delivery == Delivery::Refined);
    }
    assert_eq!(pair.settled(), [(1, count as u32)]);
    (total, refined, count)
}

#[test]
fn refined_delivery_is_exact_in_fewer_bytes() {
    let (exact_bytes, none, exact_count) = received(config(8));
    let (refined_bytes, refined, count) = received(refined_config(8));
    assert_eq!((none, count), (0, exact_count));
    assert!(refined > count / 3, "{refined} of {count}");
    assert!(refined_bytes * 10 < exact_bytes * 9, "{refined_bytes} of {exact_bytes}");
}

/// A welcomed server in refined delivery with the largest credit.
fn server() -> ServerSession {
    let mut server = ServerSession::new(offer(), 1);
    let hello = Hello { digest: None, delivery: Delivery::Refined, token: None, software: String::new() };
    for message in [ClientMessage::Hello(hello), ClientMessage::Credit { chunks: MAX_CREDITS }] {
        server.receive(DataFrame::Binary(&control::encode(&message).unwrap())).unwrap();
    }
    assert!(server.poll_transmit().is_some());
    server
}

fn request(server: &mut ServerSession, keys: &[ChunkKey]) {
    for (id, keys) in (0..).zip(keys.chunks(512)) {
        let keys = keys.iter().map(|key| (*key).into()).collect();
        let message = ClientMessage::Request { id, keys };
        server.receive(DataFrame::Binary(&control::encode(&message).unwrap())).unwrap();
    }
}

#[test]
fn a_refined_frame_is_replaced_if_its_parent_was_evicted() {
    let (land, world) = (Land::new(1), offer().digest);
    let mut server = server();
    let (child, parent) = (key(0, 3, -7), key(1, 1, -4));
    let frame = |key, delivery| chunk_codec::encode_for(delivery, &land.chunk(key), &world);
    request(&mut server, &[parent, child]);
    let (first, delivery) = server.next_chunk().unwrap();
    assert_eq!((first.key, delivery), (parent, Delivery::Exact), "the window is empty");
    server.deliver(first, frame(parent, delivery));
    let (slow, delivery) = server.next_chunk().unwrap();
    assert_eq!((slow.key, delivery), (child, Delivery::Refined));

    // As many other parents as the window holds; their content is irrelevant here.
    let others: Vec<_> = (0..MAX_REFERENCES as i32).map(|x| key(1, x, 100)).collect();
    let any = frame(others[0], Delivery::Exact);
    for part in others.chunks(512) {
        request(&mut server, part);
        for _ in part {
            let next = server.next_chunk().unwrap().0;
            server.deliver(next, any.clone());
        }
    }
    let before = (server.counts().chunks, server.credits());
    server.deliver(slow, frame(child, Delivery::Refined));
    assert_eq!((server.counts().chunks, server.credits()), (before.0, before.1 + 1), "no chunk was sent");
    let (again, delivery) = server.next_chunk().unwrap();
    assert_eq!((again, delivery), (slow, Delivery::Exact));
    server.deliver(again, frame(child, delivery));
    assert_eq!(server.counts().chunks, before.0 + 1);
    assert_eq!(server.next_chunk(), None);
}

#[test]
fn a_refined_frame_needs_its_delivery_and_its_parent() {
    let (land, world) = (Land::new(1), offer().digest);
    let welcome = ServerMessage::Welcome(Welcome {
        session: 1,
        world_seed: 1,
        generator_version: GENERATOR_VERSION,
        digest: world.0,
        max_credits: MAX_CREDITS,
        max_view_distance_m: 1,
        software: String::new(),
    });
    let child = key(0, 3, -7);
    let [parent_chunk, child_chunk] = [key(1, 1, -4), child].map(|key| land.chunk(key));
    let parent = chunk_codec::encode(&parent_chunk, &world);
    let refined = refined::encode_alone(&child_chunk, &world, Effort::default()).unwrap();
    let client = |delivery, frames: &[&bytes::Bytes]| {
        let mut client = ClientSession::new(ClientConfig { delivery, ..config(4) });
        client.receive(DataFrame::Binary(&control::encode(&welcome).unwrap())).unwrap();
        let (last, first) = frames.split_last().unwrap();
        first.iter().for_each(|frame| _ = client.receive(DataFrame::Binary(frame)).unwrap());
        client.receive(DataFrame::Binary(last))
    };
    let received = client(Delivery::Refined, &[&parent, &refined]);
    let Ok(Event::Chunk { chunk, delivery: Delivery::Refined, .. }) = received else {
        panic!("{received:?}")
    };
    assert_eq!(*chunk, child_chunk);
    assert_eq!(client(Delivery::Refined, &[&refined]), Err(ChunkError::Parent(child).into()));
    let other = chunk_codec::encode(&land.chunk(key(1, 2, -4)), &world);
    assert_eq!(client(Delivery::Refined, &[&other, &refined]), Err(ChunkError::Parent(child).into()));
    let unknown = ChunkError::UnknownKind(chunk_codec::KIND_REFINED);
    assert_eq!(client(Delivery::Exact, &[&parent, &refined]), Err(unknown.into()));
}

#[test]
fn both_reference_windows_stay_equal_over_a_long_session() {
    // Over far more parents than the window holds, in a mixed order: some are evicted and sent
    // again.
    let mut pair = Pair::with(refined_config(64));
    pair.run(0);
    let mut counts = HashMap::new();
    for step in 0..2400 {
        let x = (step * 7) % 1500;
        let keys = [key(1, x, 60), key(0, 2 * ((x * 31 + step) % 1500), 120)];
        pair.client.request(&keys);
        pair.run(usize::MAX);
        for event in pair.events.drain(..) {
            let Event::Chunk { chunk, delivery, .. } = event else { continue };
            *counts.entry((chunk.key.level(), delivery)).or_insert(0) += 1;
        }
    }
    // A client with another window would have ended the session.
    let count = |level, delivery| counts.get(&(level, delivery)).copied().unwrap_or(0);
    assert_eq!(count(1, Delivery::Exact) + count(1, Delivery::Refined), 2400);
    assert!(count(0, Delivery::Refined) > 200 && count(0, Delivery::Exact) > 200, "{counts:?}");
}

#[test]
fn both_reference_windows_stay_equal_after_rejected_frames() {
    let (mut pair, mut rejected, mut refined) = (Pair::with(refined_config(64)), HashSet::new(), 0);
    pair.run(0);
    // More parents than the window holds, so that those from before a rejected one are evicted.
    for step in 0..2 * MAX_REFERENCES as i32 {
        let parent = key(1, step, 60);
        // Two children: of this parent, and of one that is evicted or will be soon.
        let old = (step - MAX_REFERENCES as i32 - 2 + step % 5).max(0);
        let mut keys = vec![parent, key(0, 2 * step, 120), key(0, 2 * old + 1, 120)];
        if step % 50 == 40 {
            // The rejected chunk again, as a client requests it: it keeps its place.
            keys.push(key(1, step - 7, 60));
        }
        pair.client.request(&keys);
        while let Some(frame) = pair.client.poll_transmit() {
            pair.server.receive(DataFrame::Binary(&frame)).unwrap();
        }
        while let Some((request, delivery)) = pair.server.next_chunk() {
            // The error costs most of a chunk and is irrelevant here.
            let chunk = seed_only::complete(&pair.land, request.key, 0);
            let mut frame = chunk_codec::encode_for(delivery, &chunk, &pair.digest).to_vec();
            let is_damaged = request.key == parent && step % 50 == 33;
            frame[CHUNK_HEADER - 1] ^= u8::from(is_damaged);
            pair.server.deliver(request, frame.into());
        }
        while let Some(frame) = pair.server.poll_transmit() {
            let (_, key) = chunk_codec::kind_and_key(&frame).unwrap();
            match pair.client.receive(DataFrame::Binary(&frame)) {
                Ok(Event::Chunk { chunk, delivery, .. }) => {
                    rejected.remove(&chunk.key);
                    refined += u32::from(chunk.key.level() == 0 && delivery == Delivery::Refined);
                }
                Err(PeerFault::Chunk(ChunkError::Digest)) => _ = rejected.insert(key),
                // Only children of a chunk that has not come again yet.
                Err(PeerFault::Chunk(ChunkError::Parent(child))) => {
                    assert!(rejected.contains(&child.parent().unwrap()), "step {step}: {child}");
                }
                other => panic!("step {step}, {key}: {other:?}"),
            }
        }
    }
    assert!(rejected.is_empty(), "{rejected:?}");
    assert!(refined > 2 * MAX_REFERENCES as u32, "{refined} refined frames");
}
