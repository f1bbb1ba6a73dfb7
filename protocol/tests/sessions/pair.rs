//! Both machines, and what goes to and fro.

use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::server::{ServerOffer, ServerSession, Wanted};
use protocol::view::View;
use protocol::{Delivery, Incoming, chunk_codec};
use terrain::{ChunkKey, Land, WorldDigest};

/// A client and a server without anything between them.
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
    View {
        id,
        eye: [0, 25_600, 0],
        velocity: [0; 3],
        yaw_mdeg: 0,
        pitch_mdeg: 0,
        fov_mdeg: 60_000,
        viewport: [640, 360],
        tolerance_q4: 64,
        distance_m,
    }
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

    /// Carries frames until both sides are silent; makes at most `chunks` chunks.
    pub fn run(&mut self, mut chunks: usize) {
        loop {
            let mut moved = false;
            while let Some(frame) = self.client.poll_transmit() {
                self.server.receive(Incoming::Binary(&frame)).unwrap();
                moved = true;
            }
            select_views(&mut self.server);
            while chunks > 0
                && let Some((wanted, delivery)) = self.server.next_chunk()
            {
                let frame = chunk_codec::encode_for(delivery, &self.land.chunk(wanted.key), &self.digest);
                self.server.deliver(wanted, frame);
                self.delivered += 1;
                chunks -= 1;
                moved = true;
            }
            while let Some(frame) = self.server.poll_transmit() {
                self.events.push(self.client.receive(Incoming::Binary(&frame)).unwrap());
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
            Event::Settled { view, chunks } => Some((*view, *chunks)),
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

/// What a server wants next, whatever the delivery.
pub fn next_wanted(server: &mut ServerSession) -> Option<Wanted> {
    server.next_chunk().map(|(wanted, _)| wanted)
}
