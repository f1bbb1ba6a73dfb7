//! Deliveries: exact, seed-only, quantised.

use crate::pair::{Pair, config, next_request, offer, seed_only, send, view, welcome_frame, wire_keys};
use bytes::Bytes;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::message::ClientMessage;
use protocol::server::{ServerOffer, ServerSession};
use protocol::{ChunkError, CloseCode, DataFrame, Delivery, PeerFault, Tolerance, chunk_codec, limits};
use terrain::{Chunk, ChunkKey, Land};

/// All chunks of a view by key, and the bytes of their frames.
fn received(config: ClientConfig) -> (Vec<Chunk>, usize) {
    let delivery = config.delivery;
    let mut pair = Pair::with(config);
    pair.client.set_view(view(1, 1000));
    pair.run(usize::MAX);
    assert_eq!(pair.server.delivery(), delivery);
    let mut total = 0;
    let mut chunks = Vec::new();
    for event in pair.events {
        if let Event::Chunk { chunk, bytes, delivery: received } = event {
            assert_eq!(received, delivery);
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
fn seed_only_and_exact_delivery_yield_equal_chunks() {
    let (exact, exact_bytes) = received(config(64));
    let (seed, seed_bytes) = received(seed_only(64));
    assert!(exact == seed && exact.len() > 16);
    assert_eq!(seed_bytes, limits::SEED_ONLY_FRAME * seed.len());
    assert!(exact_bytes > 20 * seed_bytes, "{exact_bytes} against {seed_bytes}");
    // Control: another world's chunks are not equal.
    let other = Land::new(2);
    assert!(seed.iter().any(|chunk| *chunk != other.chunk(chunk.key)));
}

#[test]
fn a_chunk_without_heights_reserves_no_more_bytes_than_its_frame() {
    let (mut server, mut client) = (ServerSession::new(offer(), 1), ClientSession::new(seed_only(64)));
    while let Some(frame) = client.poll_transmit() {
        server.receive(DataFrame::Binary(&frame)).unwrap();
    }
    send(&mut server, &ClientMessage::Request { id: 1, keys: wire_keys(5) });
    let frame = limits::SEED_ONLY_FRAME as u32;
    send(&mut server, &ClientMessage::CreditBytes { bytes: 3 * frame });
    let in_flight: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    assert_eq!(in_flight.len(), 3);
    // An exact frame costs all its bytes.
    server.deliver(in_flight[0], Bytes::from(vec![0; 1_000]));
    send(&mut server, &ClientMessage::CreditBytes { bytes: 1_000 - 1 });
    assert_eq!(next_request(&mut server), None, "less than a frame is left");
    send(&mut server, &ClientMessage::CreditBytes { bytes: 1 });
    assert!(next_request(&mut server).is_some());
}

/// The result of one chunk frame at a welcomed client.
fn verdict(config: ClientConfig, frame: &[u8]) -> Result<Event, PeerFault> {
    let mut client = ClientSession::new(config);
    client.receive(DataFrame::Binary(&welcome_frame())).unwrap();
    client.receive(DataFrame::Binary(frame))
}

#[test]
fn a_seed_only_frame_of_another_chunk_is_rejected() {
    let ServerOffer { land, digest, .. } = offer();
    let key = ChunkKey::new(0, 3, -7).unwrap();
    let chunk = land.chunk(key);
    let frame = chunk_codec::encode_for(Delivery::SeedOnly, &chunk, &digest);
    assert!(matches!(verdict(seed_only(4), &frame), Ok(Event::Chunk { chunk: got, .. }) if *got == chunk));

    let mut heights = chunk.heights.clone();
    heights[2000] += 1;
    let other = Chunk::from_parts(key, heights, chunk.error, chunk.grass);
    let frame = chunk_codec::encode_for(Delivery::SeedOnly, &other, &digest);
    let fault = verdict(seed_only(4), &frame).unwrap_err();
    assert_eq!((fault.close_code(), fault), (CloseCode::Malformed, ChunkError::Regenerated(key).into()));
}

#[test]
fn exact_frames_are_valid_in_every_delivery_seed_only_ones_are_not() {
    let ServerOffer { land, digest, .. } = offer();
    let chunk = land.chunk(ChunkKey::new(0, 3, -7).unwrap());
    let [exact, seed] = [Delivery::Exact, Delivery::SeedOnly]
        .map(|delivery| chunk_codec::encode_for(delivery, &chunk, &digest));
    let outcome = |config, frame: &[u8]| match verdict(config, frame) {
        Ok(Event::Chunk { delivery, .. }) => Ok(delivery),
        Ok(other) => panic!("{other:?}"),
        Err(fault) => Err(fault),
    };
    assert_eq!(outcome(seed_only(4), &exact), Ok(Delivery::Exact));
    assert_eq!(outcome(seed_only(4), &seed), Ok(Delivery::SeedOnly));
    assert_eq!(outcome(config(4), &exact), Ok(Delivery::Exact));
    assert_eq!(outcome(config(4), &seed), Err(ChunkError::UnknownKind(chunk_codec::KIND_SEED_ONLY).into()));
}

#[test]
fn quantised_frames_are_valid_up_to_the_requested_tolerance_only() {
    let (land, world) = (Land::new(1), offer().digest);
    let chunk = land.chunk(ChunkKey::new(0, 3, -7).unwrap());
    let [fine, requested, coarse] = [4, 8, 16].map(|units| Tolerance::new(units).unwrap());
    let receive = |delivery, sent| {
        let mut client = ClientSession::new(ClientConfig { delivery, ..config(4) });
        client.receive(DataFrame::Binary(&welcome_frame())).unwrap();
        let frame = chunk_codec::encode_for(sent, &chunk, &world);
        client.receive(DataFrame::Binary(&frame))
    };
    for sent in [Delivery::Quantised(requested), Delivery::Quantised(fine), Delivery::Exact] {
        let Ok(Event::Chunk { chunk: got, delivery, .. }) = receive(Delivery::Quantised(requested), sent)
        else {
            panic!("{sent} was rejected");
        };
        assert_eq!(delivery, sent);
        assert_eq!(*got == chunk, sent == Delivery::Exact);
    }
    let fault = receive(Delivery::Quantised(requested), Delivery::Quantised(coarse)).unwrap_err();
    assert_eq!(fault, ChunkError::Tolerance { theirs: 16, ours: 8 }.into());
    for delivery in [Delivery::Exact, Delivery::SeedOnly] {
        let fault = receive(delivery, Delivery::Quantised(fine)).unwrap_err();
        assert_eq!(fault, ChunkError::UnknownKind(chunk_codec::KIND_QUANTISED).into(), "{delivery}");
    }
}
