//! Control frames of clients and of servers.

use crate::world::WORLD;
use protocol::control;
use protocol::message::{
    ClientMessage, Hello, RefusalReason, Refused, Rejection, ServerMessage, Settled, Welcome, WireKey,
};
use protocol::view::View;
use protocol::{Delivery, PROTOCOL_VERSION};
use terrain::constants::GENERATOR_VERSION;

/// Decodes a frame in both directions. A decoded message is encoded as the same bytes.
///
/// # Panics
/// A message is encoded as other bytes.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let from_client = control::decode::<ClientMessage>(bytes);
    let from_server = control::decode::<ServerMessage>(bytes);
    if let Ok(message) = &from_client {
        assert_eq!(control::encode(message).as_deref(), Ok(bytes));
    }
    if let Ok(message) = &from_server {
        assert_eq!(control::encode(message).as_deref(), Ok(bytes));
    }
    from_client.is_ok() || from_server.is_ok()
}

/// Every message.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let client = client_messages();
    let from_client = client.iter().filter_map(|message| control::encode(message).ok());
    let server = server_messages();
    let from_server = server.iter().filter_map(|message| control::encode(message).ok());
    from_client.chain(from_server).map(|frame| frame.to_vec()).collect()
}

/// A session of a client: the Hello first.
pub(crate) fn client_messages() -> Vec<ClientMessage> {
    let hello =
        Hello { digest: None, delivery: Delivery::Exact, token: Some("t".into()), software: "s".into() };
    let view = View {
        id: 3,
        eye: [0, 60 * 256, 0],
        velocity: [9_000, 0, -9_000],
        yaw_mdeg: 45_000,
        pitch_mdeg: -10_000,
        fov_mdeg: 60_000,
        viewport: [640, 360],
        tolerance_q4: 64,
        distance_m: 300,
    };
    let keys = || vec![WireKey { level: 0, x: 0, z: -1 }, WireKey { level: 16, x: 0, z: 0 }];
    vec![
        ClientMessage::Hello(hello),
        ClientMessage::Credit { chunks: 64 },
        ClientMessage::CreditBytes { bytes: 1 << 20 },
        ClientMessage::View(view),
        ClientMessage::Request { id: 7, keys: keys() },
        ClientMessage::Cancel { id: 7 },
        ClientMessage::Holding { keys: keys() },
        ClientMessage::Release { keys: keys() },
    ]
}

/// Messages of a server: the Welcome first.
pub(crate) fn server_messages() -> Vec<ServerMessage> {
    let welcome = Welcome {
        session: 1,
        world_seed: WORLD.land.world_seed(),
        generator_version: GENERATOR_VERSION,
        digest: WORLD.digest.0,
        max_credits: 4096,
        max_view_distance_m: 65_536,
        software: "s".into(),
    };
    let refused = Refused {
        id: 7,
        key: Some(WireKey { level: 0, x: 0, z: -1 }),
        reason: RefusalReason::Overloaded,
        detail: "later".into(),
    };
    vec![
        ServerMessage::Welcome(welcome),
        ServerMessage::Settled(Settled { view: 3, chunks: 9 }),
        ServerMessage::Refused(refused),
        ServerMessage::Draining { reconnect_after_ms: 700 },
        ServerMessage::Rejected(Rejection::Unauthorised),
        ServerMessage::Rejected(Rejection::WrongVersion { client: 1, server: PROTOCOL_VERSION }),
        ServerMessage::Rejected(Rejection::WrongWorld { client: [1; 32], server: [2; 32] }),
    ]
}
