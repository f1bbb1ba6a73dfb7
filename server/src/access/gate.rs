//! Checks tokens that clients present, and bounds how often an address may guess.

use crate::access::tokens::{Known, TokenDigest, TokenFile, TokenSet};
use crate::limits::guesses::GuessLimiter;
use crate::limits::peer_log::PeerLog;
use crate::metrics::Metrics;
use cli::UsageError;
use protocol::server::TokenCheck;
use std::net::IpAddr;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;
use tokio::time::Instant;

/// The token check of a server, shared by all connections.
#[derive(Debug)]
pub struct TokenGate {
    /// None if no token is required.
    tokens: Option<RwLock<Arc<TokenSet>>>,
    file: Option<TokenFile>,
    guesses: GuessLimiter,
    /// Those of pages of other origins. Such a page presents tokens from the address of its
    /// visitor, whose own access must not be throttled by it.
    page_guesses: GuessLimiter,
    metrics: Arc<Metrics>,
    log: Arc<PeerLog>,
}

/// What presents a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presenter {
    /// A program, or a page of the server or of an allowed origin.
    Client,
    /// A page of another origin.
    OtherPage,
}

/// Why a client is not admitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// It presents no token.
    Missing,
    /// It presents an unknown token. Counts as a guess.
    Wrong,
    /// Its token was valid once.
    Expired,
    /// Its address has guessed too often. Its token was not looked at.
    Throttled,
}

impl TokenGate {
    /// A gate that admits every client without `tokens`.
    #[must_use]
    pub fn new(
        tokens: Option<TokenSet>,
        file: Option<TokenFile>,
        metrics: Arc<Metrics>,
        log: Arc<PeerLog>,
    ) -> Self {
        let tokens = tokens.map(|tokens| RwLock::new(Arc::new(tokens)));
        Self {
            tokens,
            file,
            guesses: GuessLimiter::default(),
            page_guesses: GuessLimiter::default(),
            metrics,
            log,
        }
    }

    /// Whether clients need a token.
    #[must_use]
    pub const fn requires_token(&self) -> bool {
        self.tokens.is_some()
    }

    /// Checks the token that a client presents.
    ///
    /// # Errors
    /// Why it is not admitted.
    pub fn check(
        &self,
        client: Option<IpAddr>,
        presenter: Presenter,
        presented: Option<&str>,
    ) -> Result<(), Refusal> {
        let Some(tokens) = &self.tokens else { return Ok(()) };
        let Some(presented) = presented else { return Err(Refusal::Missing) };
        let (now, digest) = (Instant::now(), TokenDigest::of(presented));
        let guesses = match presenter {
            Presenter::Client => &self.guesses,
            Presenter::OtherPage => &self.page_guesses,
        };
        if guesses.is_exhausted(client, digest.short(), now) {
            self.metrics.limits.tokens_throttled.inc();
            self.log.report(client, "token guesses");
            return Err(Refusal::Throttled);
        }
        let tokens = Arc::clone(&tokens.read().unwrap_or_else(PoisonError::into_inner));
        match tokens.find(&digest, SystemTime::now()) {
            Known::Valid(name) => {
                tracing::debug!(token = %name, "token accepted");
                Ok(())
            }
            Known::Expired(name) => {
                tracing::debug!(token = %name, "expired token");
                self.metrics.limits.tokens_expired.inc();
                // No guess: its sender knew a valid token.
                self.log.report(client, "expired token");
                Err(Refusal::Expired)
            }
            Known::Unknown => {
                guesses.charge(client, digest.short(), now);
                self.metrics.limits.tokens_wrong.inc();
                self.log.report(client, "wrong token");
                Err(Refusal::Wrong)
            }
        }
    }

    /// Reads the file of the tokens again, without using them. None without a file.
    ///
    /// # Errors
    /// It has no valid tokens.
    pub fn read(&self) -> Result<Option<TokenSet>, UsageError> {
        self.file.as_ref().map(TokenFile::read).transpose()
    }

    /// Uses the tokens of [`TokenGate::read`] from now on. Sessions that are open go on.
    pub fn replace(&self, read: Option<TokenSet>) -> Reloaded {
        let (Some(read), Some(tokens)) = (read, &self.tokens) else { return Reloaded::Unchanged };
        let read = Arc::new(read);
        let mut current = tokens.write().unwrap_or_else(PoisonError::into_inner);
        if *current == read {
            return Reloaded::Unchanged;
        }
        *current = read;
        Reloaded::Changed
    }

    /// The check of a session whose client is at this address.
    #[must_use]
    pub fn of_session(self: &Arc<Self>, client: Option<IpAddr>) -> Arc<dyn TokenCheck> {
        Arc::new(SessionGate { gate: Arc::clone(self), client })
    }
}

/// The result of a reload of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reloaded {
    /// Its content was in use already.
    Unchanged,
    /// Its content is used from now on.
    Changed,
}

#[derive(Debug)]
struct SessionGate {
    gate: Arc<TokenGate>,
    client: Option<IpAddr>,
}

impl TokenCheck for SessionGate {
    fn admits(&self, presented: Option<&str>) -> bool {
        self.gate.check(self.client, Presenter::Client, presented).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gate(tokens: Option<TokenSet>, file: Option<TokenFile>) -> TokenGate {
        TokenGate::new(tokens, file, Arc::default(), Arc::default())
    }

    #[tokio::test(start_paused = true)]
    async fn guesses_are_throttled_per_address_and_a_throttled_address_learns_nothing() {
        let gate = gate(Some(TokenSet::one("sesame")), None);
        let check = |client, presented: Option<&str>| gate.check(client, Presenter::Client, presented);
        let [one, other] = ["10.0.0.1", "10.0.0.2"].map(|text| Some(text.parse().unwrap()));
        assert_eq!(check(one, Some("sesame")), Ok(()));
        assert_eq!(check(one, None), Err(Refusal::Missing));
        let mut outcomes = Vec::new();
        for guess in 0..2214 {
            outcomes.push(check(one, Some(&guess.to_string())).unwrap_err());
        }
        let looked_at = outcomes.iter().filter(|outcome| **outcome == Refusal::Wrong).count();
        assert_eq!(looked_at, 10, "of 2,214 guesses in no time");
        assert_eq!(check(one, Some("sesame")), Err(Refusal::Throttled));
        assert_eq!(check(other, Some("sesame")), Ok(()), "another address");
        assert_eq!(
            (gate.metrics.limits.tokens_wrong.get(), gate.metrics.limits.tokens_throttled.get()),
            (10, 2205)
        );
        tokio::time::advance(std::time::Duration::from_secs(7)).await;
        assert_eq!(check(one, Some("sesame")), Ok(()));
    }

    #[tokio::test(start_paused = true)]
    async fn guesses_of_a_page_of_another_origin_do_not_throttle_its_visitor() {
        let gate = gate(Some(TokenSet::one("sesame")), None);
        let visitor = Some("10.0.0.1".parse().unwrap());
        for guess in 0..100 {
            let _ = gate.check(visitor, Presenter::OtherPage, Some(&guess.to_string()));
        }
        assert_eq!(gate.check(visitor, Presenter::OtherPage, Some("sesame")), Err(Refusal::Throttled));
        assert_eq!(gate.check(visitor, Presenter::Client, Some("sesame")), Ok(()));
    }

    #[test]
    fn without_tokens_every_client_is_admitted() {
        for presented in [Some("anything"), None] {
            assert_eq!(gate(None, None).check(None, Presenter::Client, presented), Ok(()));
        }
    }

    #[test]
    fn a_file_is_read_again_and_an_invalid_one_changes_nothing() {
        let path = std::env::temp_dir().join(format!("tombolo-gate-{}", std::process::id()));
        std::fs::write(&path, "first\n").unwrap();
        let file = TokenFile::new(path.clone());
        let gate = gate(Some(file.read().unwrap()), Some(file));
        let check = |client, presented: Option<&str>| gate.check(client, Presenter::Client, presented);
        let reload = || gate.read().map(|read| gate.replace(read));
        assert_eq!(reload(), Ok(Reloaded::Unchanged));
        std::fs::write(&path, "second\n").unwrap();
        assert_eq!(check(None, Some("second")), Err(Refusal::Wrong));
        assert_eq!(reload(), Ok(Reloaded::Changed));
        assert_eq!((check(None, Some("second")), check(None, Some("first"))), (Ok(()), Err(Refusal::Wrong)));
        std::fs::write(&path, "").unwrap();
        assert!(reload().is_err());
        assert_eq!(check(None, Some("second")), Ok(()));
        std::fs::remove_file(path).unwrap();
        assert!(reload().is_err());
    }
}
