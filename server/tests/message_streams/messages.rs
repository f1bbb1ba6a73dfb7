//! Random valid messages, and frames that carry them.

use protocol::limits::{MAX_CREDIT_BYTES, MAX_CREDITS, MAX_KEYS, MAX_TEXT, MAX_VIEWPORT};
use protocol::message::{ClientMessage, Hello, WireKey};
use protocol::view::View;
use protocol::{Delivery, Tolerance, control};
use terrain::constants::WORLD_HALF;
use terrain::lod::MAX_VIEW_DISTANCE_M;
use test_support::Random;

/// Streams of one seed.
pub struct Generator {
    random: Random,
}

/// Number of a message's kind.
pub fn kind(message: &ClientMessage) -> usize {
    match message {
        ClientMessage::Hello(_) => 0,
        ClientMessage::View(_) => 1,
        ClientMessage::Credit { .. } => 2,
        ClientMessage::CreditBytes { .. } => 3,
        ClientMessage::Request { .. } => 4,
        ClientMessage::Release { .. } => 5,
        ClientMessage::Holding { .. } => 6,
        ClientMessage::Cancel { .. } => 7,
    }
}

impl Generator {
    pub const fn new(seed: u64) -> Self {
        Self { random: Random(seed) }
    }

    /// The first message of a session.
    pub fn hello(&mut self) -> ClientMessage {
        let deliveries = [
            Delivery::Exact,
            Delivery::Refined,
            Delivery::SeedOnly,
            Delivery::Quantised(Tolerance::COARSEST),
        ];
        let length = self.random.pick([0, MAX_TEXT], |any| any as usize % MAX_TEXT);
        ClientMessage::Hello(Hello {
            digest: None,
            delivery: deliveries[self.random.below(4)],
            token: (self.random.below(2) == 0).then(|| "t".repeat(MAX_TEXT)),
            software: "s".repeat(length),
        })
    }

    /// A message of a session after its Hello.
    pub fn message(&mut self) -> ClientMessage {
        let id = self.random.pick([0, u32::MAX], |any| any as u32);
        match self.random.below(8) {
            0 | 1 => ClientMessage::View(self.view(id)),
            2 => ClientMessage::Credit {
                chunks: self.random.pick([1, MAX_CREDITS], |any| any as u32 % MAX_CREDITS + 1),
            },
            3 => ClientMessage::CreditBytes {
                bytes: self.random.pick([1, MAX_CREDIT_BYTES], |any| any as u32 % MAX_CREDIT_BYTES + 1),
            },
            4 => ClientMessage::Request { id, keys: self.keys() },
            5 => ClientMessage::Release { keys: self.keys() },
            6 => ClientMessage::Holding { keys: self.keys() },
            _ => ClientMessage::Cancel { id },
        }
    }

    /// The frames of a Hello and so many messages.
    pub fn stream(&mut self, messages: usize) -> Vec<u8> {
        let hello = self.hello();
        let mut bytes = self.frames(&hello);
        for _ in 0..messages {
            let message = self.message();
            bytes.extend(self.frames(&message));
        }
        bytes
    }

    /// A quarter of the views are the most expensive that a server accepts.
    fn view(&mut self, id: u32) -> View {
        if self.random.below(4) == 0 {
            let (velocity, viewport) = ([i32::MAX; 3], [MAX_VIEWPORT; 2]);
            return View { velocity, viewport, tolerance_q4: 16, ..test_support::view(id, 8192) };
        }
        let place = |any: u64| (any as i32) % WORLD_HALF;
        View {
            id,
            eye: [
                self.random.pick([-WORLD_HALF, WORLD_HALF - 1, 0, i32::MIN], place),
                self.random.pick([i32::MIN, i32::MAX, 0], |any| any as i32),
                self.random.pick([-WORLD_HALF, WORLD_HALF - 1, 0, i32::MAX], place),
            ],
            velocity: [(); 3].map(|()| self.random.pick([i32::MIN, i32::MAX, 0], |any| any as i32)),
            yaw_mdeg: self.random.pick([i32::MIN, i32::MAX, 0], |any| any as i32),
            pitch_mdeg: self.random.pick([i32::MIN, i32::MAX, 0, 90_000], |any| any as i32),
            fov_mdeg: self.random.pick([1_000, 170_000, 60_000, 0, u32::MAX], |any| any as u32 % 170_000),
            viewport: [(); 2].map(|()| self.random.pick([1, MAX_VIEWPORT, 0, u16::MAX], |any| any as u16)),
            tolerance_q4: self.random.pick([1, u16::MAX, 64, 0], |any| any as u16),
            distance_m: self
                .random
                .pick([0, 1, MAX_VIEW_DISTANCE_M, u32::MAX], |any| any as u32 % MAX_VIEW_DISTANCE_M),
        }
    }

    /// Keys inside and outside of the world, some twice.
    fn keys(&mut self) -> Vec<WireKey> {
        let count = self.random.pick([0, 1, 2, MAX_KEYS], |any| any as usize % 16);
        let (level, near) = (self.random.below(17) as u8, self.random.below(2) == 0);
        (0..count)
            .map(|_| WireKey {
                level: self.random.pick([level, level, level, 255], |any| any as u8 % 20),
                x: if near { self.random.below(64) as i32 - 32 } else { self.coordinate() },
                z: if near { self.random.below(64) as i32 - 32 } else { self.coordinate() },
            })
            .collect()
    }

    fn coordinate(&mut self) -> i32 {
        self.random.pick([i32::MIN, i32::MAX, 0, -1, -32_768, 32_767, 32_768], |any| any as i32)
    }

    /// A message as frames: whole, or in fragments with control frames between them.
    pub fn frames(&mut self, message: &ClientMessage) -> Vec<u8> {
        let bytes = control::encode(message).expect("a valid message");
        let mut stream = Vec::new();
        let mut rest = &bytes[..];
        let mut opcode = 2;
        while self.random.below(3) == 0 {
            let (part, behind) = rest.split_at(self.random.below(rest.len() + 1));
            self.frame(&mut stream, opcode, part);
            (rest, opcode) = (behind, 0);
            match self.random.below(3) {
                0 => {
                    let length = self.random.pick([0, 125], |any| any as usize % 125);
                    self.frame(&mut stream, 0x89, &vec![7; length]);
                }
                1 => self.frame(&mut stream, 0x8a, b"unsolicited"),
                _ => {}
            }
        }
        self.frame(&mut stream, 0x80 | opcode, rest);
        stream
    }

    /// One masked frame. The first byte is given.
    fn frame(&mut self, stream: &mut Vec<u8>, first: u8, payload: &[u8]) {
        stream.push(first);
        match payload.len() {
            short @ 0..126 => stream.push(0x80 | short as u8),
            longer => {
                stream.push(0x80 | 126);
                stream.extend((longer as u16).to_be_bytes());
            }
        }
        let mask = (self.random.bits() as u32).to_be_bytes();
        stream.extend(mask);
        stream.extend(payload.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask));
    }
}
