//! Malformed frames.

use crate::pair::{config, next_request, offer, seed_only, select_views, view};
use proptest::prelude::*;
use protocol::client::ClientSession;
use protocol::message::{ClientMessage, Hello, WireKey};
use protocol::server::ServerSession;
use protocol::{
    ControlError, DataFrame, Delivery, PROTOCOL_VERSION, Tolerance, chunk_codec, control, limits,
};

#[test]
fn truncated_and_overlong_control_frames_are_rejected() {
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
            let cut = control::decode::<ClientMessage>(&frame[..length]);
            assert_eq!(cut, Err(ControlError::Truncated), "{length}");
        }
        for extra in [1, 2] {
            let longer = [&frame[..], &vec![0; extra]].concat();
            assert_eq!(control::decode::<ClientMessage>(&longer), Err(ControlError::Trailing(extra)));
        }
    }
}

#[test]
fn an_invalid_field_is_named_by_its_fault() {
    let tolerance = Tolerance::new(16).unwrap();
    let delivery = Delivery::Quantised(tolerance);
    let hello = Hello { digest: None, delivery, token: None, software: "software".into() };
    let frame = control::encode(&ClientMessage::Hello(hello)).unwrap();
    // Behind magic, version and variant: the digest's tag, the variant of the delivery and its
    // tolerance, the token's tag, the length of the name and the name.
    for (at, byte, fault) in [
        (10, 2, "a field has a value without meaning"),
        (15, 3, "a tolerance is a power of two from 1 to 128 units"),
        (25, 0x80, "a length field exceeds the frame limit"),
        (26, 0xff, "a text is not UTF-8"),
    ] {
        let mut other = frame.to_vec();
        other[at] = byte;
        let expected = Err(ControlError::Invalid(fault.into()));
        assert_eq!(control::decode::<ClientMessage>(&other), expected, "byte {at}");
    }
}

#[test]
fn a_list_length_beyond_the_frame_is_rejected_before_allocation() {
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
    let longest = control::decode::<ClientMessage>(&[0; limits::MAX_CONTROL_FRAME]);
    assert_eq!(longest, Err(ControlError::BadMagic));
}

proptest! {
    #[test]
    fn random_frames_cause_no_panic(
        frames in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..80), 1..8),
        framing in 0usize..4,
    ) {
        // Bare, as a control frame, as each kind of chunk frame.
        let control = [&control::MAGIC[..], &PROTOCOL_VERSION.to_le_bytes()].concat();
        let chunk = |kind| [&chunk_codec::MAGIC[..], &chunk_codec::VERSION.to_le_bytes(), &[kind]].concat();
        let start = &[vec![], control, chunk(0), chunk(1)][framing];
        for config in [config(4), seed_only(4)] {
            let mut server = ServerSession::new(offer(), 1);
            let mut client = ClientSession::new(config);
            server.receive(DataFrame::Binary(&client.poll_transmit().unwrap())).unwrap();
            client.receive(DataFrame::Binary(&server.poll_transmit().unwrap())).unwrap();
            for frame in &frames {
                let frame = [&start[..], frame].concat();
                let _ = server.receive(DataFrame::Binary(&frame));
                let _ = client.receive(DataFrame::Binary(&frame));
                select_views(&mut server);
                while next_request(&mut server).is_some() {}
            }
        }
    }
}
