//! How much a server may do wrong before the viewer gives it up. Outlives sessions, so that a
//! server cannot start over by closing the connection.

/// Bad chunks, and sessions that broke the transport's rules, after which a server is given up.
pub const MAX_BAD: u32 = 8;

/// Good chunks that make up for a bad one.
const GOOD_PER_BAD: u32 = 1024;

/// Frames without a use that a server may have sent in advance: repeated chunks, answers to
/// nothing, pings. One more for each good chunk and each second.
pub const MAX_SURPLUS: u32 = 4096;

/// Why a server is given up.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Untrusted {
    /// Too much was bad.
    #[error(
        "{MAX_BAD} bad chunks or messages, the last: {last}; check the server or name another with --connect"
    )]
    Bad {
        /// The last fault, one line.
        last: String,
    },
    /// Too much had no use.
    #[error(
        "more than {MAX_SURPLUS} repeated chunks and messages without a cause; check the server or name \
         another with --connect"
    )]
    Surplus,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Trust {
    bad: u32,
    /// Good chunks since the last one that made up for a bad one.
    good: u32,
    surplus: u32,
}

impl Trust {
    /// Counts a good chunk.
    pub fn good(&mut self) {
        self.surplus = self.surplus.saturating_sub(1);
        self.good += 1;
        if self.good == GOOD_PER_BAD {
            (self.good, self.bad) = (0, self.bad.saturating_sub(1));
        }
    }

    /// Counts a bad chunk or a broken session, with its fault in one line.
    ///
    /// # Errors
    /// It was the last of [`MAX_BAD`].
    pub fn bad(&mut self, fault: &str) -> Result<(), Untrusted> {
        self.bad += 1;
        if self.bad >= MAX_BAD { Err(Untrusted::Bad { last: fault.to_owned() }) } else { Ok(()) }
    }

    /// Counts a frame without a use.
    ///
    /// # Errors
    /// It was one more than [`MAX_SURPLUS`].
    pub fn surplus(&mut self) -> Result<(), Untrusted> {
        self.surplus += 1;
        if self.surplus > MAX_SURPLUS { Err(Untrusted::Surplus) } else { Ok(()) }
    }

    /// Some seconds have passed.
    pub fn seconds_passed(&mut self, seconds: u32) {
        self.surplus = self.surplus.saturating_sub(seconds);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_bad_chunks_are_too_many_and_good_ones_make_up_for_them() {
        let mut trust = Trust::default();
        for _ in 1..MAX_BAD {
            assert_eq!(trust.bad("a fault"), Ok(()));
        }
        let mut forgiving = trust.clone();
        let line = trust.bad("the last fault").unwrap_err().to_string();
        assert!(line.contains("8 bad") && line.contains("the last fault") && !line.contains('\n'), "{line}");
        (0..GOOD_PER_BAD).for_each(|_| forgiving.good());
        assert_eq!(forgiving.bad("a fault"), Ok(()));
        assert!(forgiving.bad("a fault").is_err());
    }

    #[test]
    fn a_flood_without_a_use_is_too_much_and_time_makes_up_for_it() {
        let mut trust = Trust::default();
        for _ in 0..MAX_SURPLUS {
            assert_eq!(trust.surplus(), Ok(()));
        }
        trust.good();
        trust.seconds_passed(2);
        for _ in 0..3 {
            assert_eq!(trust.surplus(), Ok(()));
        }
        assert_eq!(trust.surplus(), Err(Untrusted::Surplus));
    }
}
