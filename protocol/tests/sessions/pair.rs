//! A client and a server session connected without a transport, and helpers of all suites.

use bytes::Bytes;
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::message::{ClientMessage, Hello, RefusalReason, ServerMessage, WireKey};
use protocol::server::{ChunkRequest, ServerOffer, ServerSession};
use protocol::view::View;
use protocol::{DataFrame, Delivery, chunk_codec, control};
use terrain::{ChunkKey, Land, WorldDigest};

/// A client and a server session, connected directly.
pub struct Pair {
    pub client: ClientSession,
    pub server: ServerSession,
    pub land: Land,
    pub digest: WorldDigest,
    pub events: Vec<Event>,
    pub delivered: usize,
}

pub fn offer() -> ServerOffer {
    let land = Land::new(1);
    ServerOffer { land, digest: land.digest(), token: None, software: "test server".into() }
}

pub fn config(window: u32) -> ClientConfig {
    ClientConfig {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: "test client".into(),
        window,
    }
}

pub fn view(id: u32, distance_m: u32) -> View {
    View { eye: [0, 25_600, 0], ..test_support::view(id, distance_m) }
}

impl Pair {
    pub fn new(window: u32) -> Self {
        Self::with(config(window))
    }

    pub fn with(config: ClientConfig) -> Self {
        let offer = offer();
        let (land, digest) = (offer.land, offer.digest);
        let (client, server) = (ClientSession::new(config), ServerSession::new(offer, 1));
        Self { client, server, land, digest, events: Vec::new(), delivered: 0 }
    }

    /// Carries frames until neither side has one; generates at most `chunks` chunks.
    pub fn run(&mut self, mut chunks: usize) {
        loop {
            let mut moved = false;
            while let Some(frame) = self.client.poll_transmit() {
                self.server.receive(DataFrame::Binary(&frame)).unwrap();
                moved = true;
            }
            select_views(&mut self.server);
            while chunks > 0
                && let Some((request, delivery)) = self.server.next_chunk()
            {
                let frame = chunk_codec::encode_for(delivery, &self.land.chunk(request.key), &self.digest);
                self.server.deliver(request, frame);
                self.delivered += 1;
                chunks -= 1;
                moved = true;
            }
            while let Some(frame) = self.server.poll_transmit() {
                self.events.push(self.client.receive(DataFrame::Binary(&frame)).unwrap());
                moved = true;
            }
            if !moved {
                return;
            }
        }
    }

    pub fn chunk_keys(&self) -> Vec<ChunkKey> {
        let key = |event: &Event| match event {
            Event::Chunk { chunk, .. } => Some(chunk.key),
            _ => None,
        };
        self.events.iter().filter_map(key).collect()
    }

    pub fn settled(&self) -> Vec<(u32, u32)> {
        let settled = |event: &Event| match event {
            Event::Settled(settled) => Some((settled.view, settled.chunks)),
            _ => None,
        };
        self.events.iter().filter_map(settled).collect()
    }
}

/// Runs the selections that a worker would run.
pub fn select_views(server: &mut ServerSession) {
    while let Some(selection) = server.take_view() {
        server.apply_view(selection);
    }
}

/// The next chunk that a server needs, in any delivery.
pub fn next_request(server: &mut ServerSession) -> Option<ChunkRequest> {
    server.next_chunk().map(|(request, _)| request)
}

pub fn seed_only(window: u32) -> ClientConfig {
    ClientConfig { delivery: Delivery::SeedOnly, ..config(window) }
}

pub fn welcome_frame() -> Bytes {
    let mut server = ServerSession::new(offer(), 1);
    let hello = ClientMessage::Hello(Hello {
        digest: None,
        delivery: Delivery::Exact,
        token: None,
        software: String::new(),
    });
    server.receive(DataFrame::Binary(&control::encode(&hello).unwrap())).unwrap();
    server.poll_transmit().unwrap()
}

/// Sends a message to a server as a frame and runs the selections.
pub fn send(server: &mut ServerSession, message: &ClientMessage) {
    server.receive(DataFrame::Binary(&control::encode(message).unwrap())).unwrap();
    select_views(server);
}

/// A welcomed server with credit for `credits` chunks and an empty outbox.
pub fn welcomed(credits: u32) -> ServerSession {
    let mut server = ServerSession::new(offer(), 1);
    let mut client = ClientSession::new(config(credits));
    while let Some(frame) = client.poll_transmit() {
        server.receive(DataFrame::Binary(&frame)).unwrap();
    }
    while server.poll_transmit().is_some() {}
    server
}

pub fn wire_keys(count: i32) -> Vec<WireKey> {
    (0..count).map(|x| WireKey { level: 0, x, z: 0 }).collect()
}

/// The refusals in the outbox of a server, by id and reason.
pub fn refusals(server: &mut ServerSession) -> Vec<(u32, RefusalReason)> {
    let refused = |frame: Bytes| match control::decode(&frame) {
        Ok(ServerMessage::Refused(refused)) => Some((refused.id, refused.reason)),
        _ => None,
    };
    std::iter::from_fn(|| server.poll_transmit()).filter_map(refused).collect()
}
