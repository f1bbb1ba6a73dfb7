//! Credit of a session: what the client still allows, in chunks, and in bytes of their frames once
//! it has granted bytes.

use crate::delivery::Delivery;
use crate::limits::{MAX_CHUNK_FRAME, MAX_CREDIT_BYTES, MAX_CREDITS, SEED_ONLY_FRAME};

/// See the module.
#[derive(Debug)]
pub(super) struct Credit {
    chunks: u32,
    /// Less the reservations of chunks in flight. Below 0 where the first grant did not cover
    /// these, and after an exact frame in seed-only delivery. None while only chunks are counted.
    bytes: Option<i64>,
    /// Bytes reserved for a chunk whose frame is not encoded yet.
    frame_bound: u32,
}

impl Credit {
    /// None yet, for the frames of a delivery.
    pub(super) const fn of(delivery: Delivery) -> Self {
        let frame_bound = match delivery {
            Delivery::SeedOnly => SEED_ONLY_FRAME as u32,
            _ => MAX_CHUNK_FRAME as u32,
        };
        Self { chunks: 0, bytes: None, frame_bound }
    }

    /// Chunks that the client still allows.
    pub(super) const fn chunks(&self) -> u32 {
        self.chunks
    }

    /// Whether the client allows one more chunk.
    pub(super) fn allows_one(&self) -> bool {
        self.chunks > 0 && self.bytes.is_none_or(|bytes| bytes >= i64::from(self.frame_bound))
    }

    pub(super) fn grant_chunks(&mut self, chunks: u32) {
        self.chunks = self.chunks.saturating_add(chunks).min(MAX_CREDITS);
    }

    /// Bytes are counted from the first grant on; the requests in flight then count too.
    pub(super) fn grant_bytes(&mut self, bytes: u32, in_flight: u32) {
        self.bytes = self.bytes.or(Some(-(i64::from(in_flight) * i64::from(self.frame_bound))));
        self.add_bytes(i64::from(bytes));
    }

    /// Takes the credit of one chunk, and the bytes of the longest frame.
    pub(super) fn reserve(&mut self) {
        self.chunks -= 1;
        self.add_bytes(-i64::from(self.frame_bound));
    }

    /// Charges the length of a frame in place of its reservation. An exact frame in seed-only
    /// delivery is longer: its excess is charged, too.
    pub(super) fn charge(&mut self, frame: usize) {
        self.add_bytes(i64::from(self.frame_bound) - frame as i64);
    }

    /// Returns the credit of a chunk that is not sent.
    pub(super) fn give_back(&mut self) {
        self.grant_chunks(1);
        self.add_bytes(i64::from(self.frame_bound));
    }

    fn add_bytes(&mut self, more: i64) {
        if let Some(bytes) = &mut self.bytes {
            *bytes = (*bytes + more).min(i64::from(MAX_CREDIT_BYTES));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A credit with more chunks than any test takes.
    fn granted(delivery: Delivery, bytes: usize) -> Credit {
        let mut credit = Credit::of(delivery);
        credit.grant_chunks(MAX_CREDITS);
        credit.grant_bytes(bytes as u32, 0);
        credit
    }

    fn reserve_all(credit: &mut Credit) -> usize {
        std::iter::from_fn(|| credit.allows_one().then(|| credit.reserve())).count()
    }

    #[test]
    fn a_frame_is_charged_by_its_length_and_not_by_its_reservation() {
        let mut credit = granted(Delivery::Exact, 2 * MAX_CHUNK_FRAME);
        assert_eq!(reserve_all(&mut credit), 2);
        credit.charge(MAX_CHUNK_FRAME);
        credit.charge(0);
        assert_eq!(reserve_all(&mut credit), 1);
        credit.give_back();
        assert_eq!(reserve_all(&mut credit), 1);
    }

    #[test]
    fn the_excess_of_an_exact_frame_in_seed_only_delivery_is_a_debt() {
        let mut credit = granted(Delivery::SeedOnly, 2 * SEED_ONLY_FRAME);
        credit.reserve();
        credit.charge(2_000);
        assert!(!credit.allows_one(), "2,000 of 72 bytes were sent");
        credit.grant_bytes(2_000 - SEED_ONLY_FRAME as u32 - 1, 0);
        assert!(!credit.allows_one(), "a byte less than a frame is left");
        credit.grant_bytes(1, 0);
        assert_eq!(reserve_all(&mut credit), 1);
    }

    #[test]
    fn sums_are_cut_to_their_limits() {
        let mut credit = granted(Delivery::Exact, MAX_CREDIT_BYTES as usize);
        credit.grant_chunks(MAX_CREDITS);
        credit.grant_bytes(MAX_CREDIT_BYTES, 0);
        credit.give_back();
        assert_eq!((credit.chunks, credit.bytes), (MAX_CREDITS, Some(i64::from(MAX_CREDIT_BYTES))));
    }
}
