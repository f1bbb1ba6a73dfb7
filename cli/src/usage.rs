//! Errors of options that parse but have unusable values.

use std::fmt;
use std::path::Path;

/// An unusable option, variable or file: one line with its name, its value and the allowed values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsageError(String);

impl UsageError {
    /// An error from its line.
    pub fn new(line: impl Into<String>) -> Self {
        Self(line.into())
    }
}

impl fmt::Display for UsageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UsageError {}

/// The first line of an access-token file.
///
/// # Errors
/// The file cannot be read, or its first line does not hold 1 to `longest` bytes.
pub fn read_token(path: &Path, longest: usize) -> Result<String, UsageError> {
    let shown = path.display();
    let text = std::fs::read_to_string(path)
        .map_err(|error| UsageError(format!("token-file: cannot read `{shown}`: {error}")))?;
    let token = text.lines().next().unwrap_or_default().trim();
    if (1..=longest).contains(&token.len()) {
        return Ok(token.into());
    }
    Err(UsageError(format!("token-file: the first line of `{shown}` must hold 1 to {longest} bytes")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_token_is_the_trimmed_first_line_within_its_limit() {
        let path = std::env::temp_dir().join(format!("tombolo-token-{}", std::process::id()));
        for (content, token) in [
            ("secret\nrest", Some("secret")),
            ("  spaced \n", Some("spaced")),
            ("", None),
            ("123456789", None),
        ] {
            std::fs::write(&path, content).unwrap();
            assert_eq!(read_token(&path, 8).ok().as_deref(), token, "{content:?}");
        }
        std::fs::remove_file(&path).unwrap();
        assert!(read_token(&path, 8).unwrap_err().to_string().contains("cannot read"));
    }
}
