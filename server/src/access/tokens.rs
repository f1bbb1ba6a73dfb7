//! The access tokens of clients and their file.
//!
//! A list is in TOML: entries `[[token]]` with `name`, `token` and, if it ends, `expires`. A file
//! with a line that begins with `[` or `#`, or with a first line that assigns a value, is read as a
//! list, so that no part of a misspelt list becomes a token. Of any other file the first line is
//! the only token.

use chrono::DateTime;
use cli::UsageError;
use protocol::limits::MAX_TEXT;
use serde::Deserialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use subtle::{ConditionallySelectable, ConstantTimeEq};

/// Name of the token of a file without names.
const ONLY: &str = "token";

/// Tokens in a file at most: every check compares with all of them.
const MAX_TOKENS: usize = 1000;

/// A set of tokens. Only their digests are kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenSet {
    tokens: Vec<Token>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Token {
    name: Arc<str>,
    digest: TokenDigest,
    expires: Option<SystemTime>,
}

/// Digest of a token. Digests have one length, so that their comparison says nothing about the
/// length of a token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenDigest([u8; 32]);

/// A file of tokens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenFile {
    path: PathBuf,
}

/// The state of a presented token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Known {
    /// The token of this name.
    Valid(Arc<str>),
    /// The token of this name, after its end.
    Expired(Arc<str>),
    /// No token.
    Unknown,
}

impl TokenSet {
    /// One token without an end.
    #[must_use]
    pub fn one(token: &str) -> Self {
        Self { tokens: vec![Token { name: ONLY.into(), digest: TokenDigest::of(token), expires: None }] }
    }

    /// Number of tokens.
    #[must_use]
    pub fn len(&self) -> usize {
        self.tokens.len()
    }

    /// Whether there is no token. Then no client is admitted.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.tokens.is_empty()
    }

    /// Looks a token up. The time depends neither on the token nor on which one it equals.
    #[must_use]
    pub fn find(&self, presented: &TokenDigest, now: SystemTime) -> Known {
        // One more than the index; 0 for none.
        let mut found = 0u32;
        for (number, token) in (1u32..).zip(&self.tokens) {
            found.conditional_assign(&number, token.digest.0.ct_eq(&presented.0));
        }
        let Some(token) = found.checked_sub(1).and_then(|index| self.tokens.get(index as usize)) else {
            return Known::Unknown;
        };
        if token.expires.is_some_and(|end| end <= now) {
            return Known::Expired(Arc::clone(&token.name));
        }
        Known::Valid(Arc::clone(&token.name))
    }
}

impl TokenDigest {
    /// Of a token.
    #[must_use]
    pub fn of(token: &str) -> Self {
        Self(*blake3::hash(token.as_bytes()).as_bytes())
    }

    /// A part of it, to recognise a token.
    #[must_use]
    pub fn short(&self) -> u64 {
        self.0.iter().take(8).fold(0, |bits, byte| bits << 8 | u64::from(*byte))
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    token: Vec<Entry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    token: String,
    expires: Option<toml::value::Datetime>,
}

impl TokenFile {
    /// A file by its path.
    #[must_use]
    pub const fn new(path: PathBuf) -> Self {
        Self { path }
    }

    /// Reads the tokens.
    ///
    /// # Errors
    /// The file cannot be read or holds no valid tokens. The message contains no token.
    pub fn read(&self) -> Result<TokenSet, UsageError> {
        let shown = self.path.display();
        let text = std::fs::read_to_string(&self.path)
            .map_err(|error| UsageError::new(format!("token-file: cannot read `{shown}`: {error}")))?;
        parse(&text).map_err(|why| UsageError::new(format!("token-file: `{shown}`: {why}")))
    }
}

fn parse(text: &str) -> Result<TokenSet, String> {
    // Of editors that mark UTF-8.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let first = text.lines().next().unwrap_or_default();
    let is_of_list = |line: &str| line.trim_start().starts_with(['[', '#']);
    if !(text.lines().any(is_of_list) || is_of_structure(first)) {
        let token = first.trim();
        check_token(token).map_err(|why| format!("the first line {why}"))?;
        return Ok(TokenSet::one(token));
    }
    let list: List = toml::from_str(text).map_err(|error| {
        let line = error.span().map_or(1, |span| text[..span.start].lines().count().max(1));
        // The message of the parser quotes no value of a string.
        let message = error.message().lines().next().unwrap_or_default();
        format!(
            "line {line}: {message}; give entries [[token]] with name and token, or one token on the \
             first line of a file without comments"
        )
    })?;
    if list.token.len() > MAX_TOKENS {
        return Err(format!("{} tokens are too many; give at most {MAX_TOKENS}", list.token.len()));
    }
    let mut tokens: Vec<Token> = Vec::new();
    for Entry { name, token, expires } in list.token {
        let shown: String = name.chars().filter(|letter| !letter.is_control()).take(64).collect();
        if name.is_empty() || name != shown {
            return Err(format!("the name `{shown}` must have 1 to 64 printable characters"));
        }
        check_token(&token).map_err(|why| format!("the token of `{name}` {why}"))?;
        let expires =
            expires.map(|end| moment(&end)).transpose().map_err(|why| format!("`{name}`: {why}"))?;
        let token = Token { name: name.into(), digest: TokenDigest::of(&token), expires };
        if let Some(other) =
            tokens.iter().find(|other| other.name == token.name || other.digest == token.digest)
        {
            return Err(format!("`{}` and `{}` share a name or a token", other.name, token.name));
        }
        tokens.push(token);
    }
    Ok(TokenSet { tokens })
}

/// Whether a line is of JSON or YAML, or `key = value` in TOML. Tokens in Base64 may end with `=`.
fn is_of_structure(line: &str) -> bool {
    let line = line.trim();
    let is_entry = |key: &str| ["name", "token", "expires"].contains(&key.trim());
    if line.starts_with('{')
        || line.starts_with("- ")
        || line.split_once(['=', ':']).is_some_and(|(key, _)| is_entry(key))
    {
        return true;
    }
    line.split_once('=').is_some_and(|(key, value)| {
        let is_key = |letter: char| letter.is_ascii_alphanumeric() || "-_.\"' ".contains(letter);
        !key.trim().is_empty()
            && key.chars().all(is_key)
            && value.trim_start().starts_with(['"', '\'', '[', '{'])
    })
}

/// What [`protocol::message::Hello`] and `Authorization` can both carry. A subprotocol entry
/// carries any bytes, in base64url.
fn check_token(token: &str) -> Result<(), String> {
    if !(1..=MAX_TEXT).contains(&token.len()) {
        return Err(format!("must hold 1 to {MAX_TEXT} bytes"));
    }
    // Spaces around a header's value are no part of it (RFC 9110, section 5.5).
    if token != token.trim() || !token.bytes().all(|byte| matches!(byte, b' '..=b'~')) {
        return Err("must be printable ASCII without a space at its start or end".to_owned());
    }
    Ok(())
}

fn moment(end: &toml::value::Datetime) -> Result<SystemTime, String> {
    let text = end.to_string();
    let parsed = DateTime::parse_from_rfc3339(&text).map_err(|_| {
        format!("expires = {text} has no date, time or offset; write it as 2027-01-31T18:00:00Z")
    })?;
    // A moment before 1970 is over as well.
    let seconds = u64::try_from(parsed.timestamp()).unwrap_or(0);
    Ok(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIST: &str = "# Clients of 2026\n\
        [[token]]\nname = \"alice\"\ntoken = \"wonder\"\n\n\
        [[token]]\nname = \"bob\"\ntoken = \"builder\"\nexpires = 2026-01-31T18:00:00+01:00\n";

    fn find(set: &TokenSet, token: &str, now: SystemTime) -> Known {
        set.find(&TokenDigest::of(token), now)
    }

    fn at(seconds: u64) -> SystemTime {
        SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)
    }

    #[test]
    fn a_file_without_a_list_has_one_token_in_its_first_line() {
        for (text, token) in
            [("secret\nrest", "secret"), ("  spaced out \n", "spaced out"), ("\u{feff}YQ==\nrest", "YQ==")]
        {
            let set = parse(text).unwrap();
            assert_eq!(find(&set, token, at(0)), Known::Valid(ONLY.into()), "{text}");
            assert_eq!((find(&set, "rest", at(0)), find(&set, "", at(0))), (Known::Unknown, Known::Unknown));
        }
        for text in ["", "\nsecret", &"x".repeat(MAX_TEXT + 1)] {
            assert!(parse(text).unwrap_err().contains("1 to 256 bytes"));
        }
    }

    /// Such a token was accepted, and no `Authorization` could carry it.
    #[test]
    fn a_token_that_no_header_can_carry_is_refused() {
        let entry = |token: &str| format!("[[token]]\nname = \"a\"\ntoken = \"{token}\"\n");
        for (text, entry) in [
            ("schlüssel".to_owned(), "the first line"),
            ("two\twords".to_owned(), "the first line"),
            (entry("schlüssel"), "the token of `a`"),
            (entry("two\\twords"), "the token of `a`"),
            (entry("line\\n"), "the token of `a`"),
            (entry(" hush"), "the token of `a`"),
            (entry("hush "), "the token of `a`"),
        ] {
            let message = parse(&text).unwrap_err();
            assert!(message.starts_with(entry) && message.contains("printable ASCII"), "{text}: {message}");
            assert!(!message.contains('\n') && !message.contains("hush"), "{message}");
        }
        // The control: all that a header can carry.
        let all: String = ('!'..='~').filter(|letter| !"\\\"".contains(*letter)).collect();
        let set = parse(&entry(&format!("a {all}"))).unwrap();
        assert_eq!(find(&set, &format!("a {all}"), at(0)), Known::Valid("a".into()));
    }

    /// Else anybody who knows the format could guess the token.
    #[test]
    fn no_part_of_a_list_is_a_token() {
        let entry = "name = \"a\"\ntoken = \"hush\"\n";
        for text in [
            format!("[[token]] # ours\n{entry}"),
            format!("[[ token ]]\n{entry}"),
            format!("\u{feff}[[token]]\n{entry}"),
            "token = [{ name = \"a\", token = \"hush\" }]".into(),
        ] {
            assert_eq!(find(&parse(&text).unwrap(), "hush", at(0)), Known::Valid("a".into()), "{text}");
        }
        for text in [
            format!("[token]\n{entry}"),
            format!("[[tokens]]\n{entry}"),
            format!("{entry}[[token]]"),
            entry.to_owned(),
            "# tokens of our clients\nhush".into(),
            "hush\n# of 2026".into(),
            "expires = 2027-01-31T18:00:00Z\nname = \"a\"\ntoken = \"hush\"".into(),
            "{ \"token\": \"hush\" }".into(),
            "- name: a\n  token: hush".into(),
            "token: hush".into(),
        ] {
            let message = parse(&text).unwrap_err();
            assert!(message.contains("[[token]]") && !message.contains("hush"), "{text}: {message}");
        }
    }

    #[test]
    fn tokens_of_a_list_have_names_and_end_at_their_moment() {
        let set = parse(LIST).unwrap();
        // 17:00:00 UTC of 31 January 2026.
        let end = 1_769_878_800;
        assert_eq!((set.len(), set.is_empty()), (2, false));
        assert_eq!(find(&set, "wonder", at(end)), Known::Valid("alice".into()));
        assert_eq!(find(&set, "builder", at(end - 1)), Known::Valid("bob".into()));
        assert_eq!(find(&set, "builder", at(end)), Known::Expired("bob".into()));
        for wrong in ["builde", "builder2", "Builder", "alice", ""] {
            assert_eq!(find(&set, wrong, at(0)), Known::Unknown, "{wrong}");
        }
    }

    #[test]
    fn a_wrong_list_is_refused_without_its_tokens() {
        for (text, word) in [
            ("[[token]]\nname = \"a\"\n", "token"),
            ("[[token]]\nname = \"a\"\ntoken = \"hush\"\nexpire = 1\n", "expire"),
            ("[[token]]\nname = \"a\"\ntoken = \"hush\"\nexpires = 2026-01-31\n", "2027-01-31T18:00:00Z"),
            ("[[token]]\nname = \"a\"\ntoken = \"hush\"\nexpires = 18:00:00\n", "18:00:00"),
            ("[[token]]\nname = \"\"\ntoken = \"hush\"\n", "1 to 64"),
            ("[[token]]\nname = \"a\"\ntoken = \"\"\n", "1 to 256"),
            (
                "[[token]]\nname = \"a\"\ntoken = \"hush\"\n[[token]]\nname = \"b\"\ntoken = \"hush\"\n",
                "share",
            ),
            (
                "[[token]]\nname = \"a\"\ntoken = \"hush\"\n[[token]]\nname = \"a\"\ntoken = \"mum\"\n",
                "share",
            ),
            ("[[token]]\nname = \"a\"\ntoken = hush\n", "line 3"),
        ] {
            let message = parse(text).unwrap_err();
            assert!(message.contains(word) && !message.contains('\n'), "{message}");
            assert!(!message.contains("hush"), "{message}");
        }
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = TokenFile::new("/does/not/exist".into()).read().unwrap_err().to_string();
        assert!(message.contains("token-file") && message.contains("/does/not/exist"), "{message}");
    }
}
