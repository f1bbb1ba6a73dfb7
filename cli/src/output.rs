//! Files that programs write.

use crate::UsageError;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// Writes a file whole or not at all: beside the file, then over it. A full disk costs no older
/// file. A path that is no regular file, such as a device or a pipe, is written directly.
///
/// # Errors
/// The file cannot be created, or `write` fails.
pub fn replace_file<E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(File) -> Result<(), E>,
) -> Result<(), E> {
    if fs::metadata(path).is_ok_and(|known| !known.is_file()) {
        return write(File::create(path)?);
    }
    let part = part_of(path);
    let written = File::create(&part).map_err(E::from).and_then(write);
    let written = written.and_then(|()| fs::rename(&part, path).map_err(E::from));
    if written.is_err() {
        // The error to report is the first one.
        let _ = fs::remove_file(&part);
    }
    written
}

/// The name of a file while it is written.
fn part_of(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".part");
    name.into()
}

/// Fails if two options name the same file: the second one would replace the first.
///
/// # Errors
/// A [`UsageError`] that names both.
pub fn are_apart(first: (&str, Option<&Path>), second: (&str, Option<&Path>)) -> Result<(), UsageError> {
    let place = |path: Option<&Path>| path.map(|path| fs::canonicalize(path).unwrap_or_else(|_| path.into()));
    let (Some(one), Some(other)) = (place(first.1), place(second.1)) else { return Ok(()) };
    // A device takes both.
    if one != other || fs::metadata(&one).is_ok_and(|known| !known.is_file()) {
        return Ok(());
    }
    let shown = one.display();
    Err(UsageError::new(format!("{} and {} both name `{shown}`: choose two files", first.0, second.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("tombolo-output-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_failed_write_keeps_the_older_file_and_leaves_no_other() {
        let folder = folder("failed");
        let path = folder.join("a.json");
        let write = |text: &'static str| move |mut file: File| file.write_all(text.as_bytes());
        replace_file(&path, write("old")).unwrap();
        let fails = |mut file: File| file.write_all(b"half").and(Err(io::ErrorKind::StorageFull.into()));
        assert!(replace_file(&path, fails).is_err());
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        replace_file(&path, write("new")).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert!(replace_file(&folder.join("none/b.json"), write("x")).is_err());
        assert!(replace_file(&folder, write("x")).is_err(), "a folder");
        fs::remove_dir_all(folder).unwrap();
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_device_is_written_and_not_replaced() {
        replace_file(Path::new("/dev/null"), |mut file| file.write_all(b"x")).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
        assert!(replace_file(Path::new("/dev/full"), |mut file| file.write_all(b"x")).is_err());
    }

    #[test]
    fn two_options_name_two_files() {
        let folder = folder("apart");
        let (one, other) = (folder.join("a.png"), folder.join("./a.png"));
        fs::write(&one, "").unwrap();
        let apart = |other: Option<&Path>| are_apart(("--shot", Some(&one)), ("--stats", other));
        let line = apart(Some(&other)).unwrap_err().to_string();
        assert!(line.contains("--shot") && line.contains("--stats"), "{line}");
        assert_eq!((apart(None), apart(Some(&folder.join("b.json")))), (Ok(()), Ok(())));
        fs::remove_dir_all(folder).unwrap();
    }
}
