//! Screenshots: files that never replace others.

use crate::gpu::Image;
use crate::native::png_file;
use anyhow::Context as _;
use std::fs::OpenOptions;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Most files of this name in a folder.
const MOST: u32 = 100_000;

/// Writes an image as `tombolo-N.png` in a folder, with the first number that no file has.
///
/// # Errors
/// The folder cannot be written, or has all numbers.
pub fn save(folder: &Path, image: &Image) -> anyhow::Result<PathBuf> {
    for number in 1..=MOST {
        let path = folder.join(format!("tombolo-{number}.png"));
        // Fails if the file exists, also if another program made it a moment ago.
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(file) => {
                let written = png_file::write_to(file, image);
                if written.is_err() {
                    // A part of a picture; best effort.
                    let _ = std::fs::remove_file(&path);
                }
                written.with_context(|| format!("cannot write {}", path.display()))?;
                return Ok(path);
            }
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error).with_context(|| format!("cannot write {}", path.display())),
        }
    }
    anyhow::bail!("{} has {MOST} pictures: remove some", folder.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_screenshot_never_replaces_a_file() {
        let folder = std::env::temp_dir().join(format!("tombolo-capture-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("tombolo-1.png"), b"another").unwrap();
        let image = Image { width: 1, height: 1, rgba: vec![9, 8, 7, 255] };
        let paths = [save(&folder, &image).unwrap(), save(&folder, &image).unwrap()];
        let kept = std::fs::read(folder.join("tombolo-1.png")).unwrap();
        let read = png_file::read(&paths[1]).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(paths, [folder.join("tombolo-2.png"), folder.join("tombolo-3.png")]);
        assert_eq!((kept, read.rgb(0, 0)), (b"another".to_vec(), [9.0 / 255.0, 8.0 / 255.0, 7.0 / 255.0]));
        assert!(save(Path::new("/no/such/folder"), &image).is_err());
    }
}
