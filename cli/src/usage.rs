//! Errors of options that parse but have unusable values.

use std::fmt;
use std::fs::File;
use std::io::Read;
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
    // No more than the line needs: a device or a large file has no end.
    let limit = (longest as u64).saturating_mul(2).saturating_add(2);
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(limit).read_to_end(&mut bytes));
    read.map_err(|error| UsageError(format!("token-file: cannot read `{shown}`: {error}")))?;
    let line = bytes.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let token = std::str::from_utf8(line).unwrap_or_default().trim();
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
            ("\u{feff}1234567890123456789012345678901234567890", None),
        ] {
            std::fs::write(&path, content).unwrap();
            assert_eq!(read_token(&path, 8).ok().as_deref(), token, "{content:?}");
        }
        #[cfg(target_os = "linux")]
        assert!(read_token(Path::new("/dev/zero"), 8).unwrap_err().to_string().contains("1 to 8 bytes"));
        std::fs::remove_file(&path).unwrap();
        assert!(read_token(&path, 8).unwrap_err().to_string().contains("cannot read"));
    }
}
