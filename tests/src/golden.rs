//! Comparing pictures with golden ones.
//!
//! A golden picture lies under `tests/golden/`. `TOMBOLO_BLESS=1` writes it; a failure writes what
//! was drawn and says where.

use client::render::Picture;
use std::path::{Path, PathBuf};

/// How different two pictures are.
#[must_use]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Mean over pixels and colour channels of the absolute difference, 0 to 255.
    pub mean: f64,
    /// Share of pixels with a channel that differs by more than 32.
    pub outliers: f64,
}

/// What is still called the same picture: drivers may round, fuse and reorder float arithmetic and
/// place the edges of triangles differently by a fraction of a pixel. That moves single pixels at
/// silhouettes a lot and all others hardly; a wrong shade, place or shape moves many.
pub const TOLERANCE: Difference = Difference { mean: 1.5, outliers: 0.01 };

impl Difference {
    /// Measures two pictures. Pictures of different size are entirely different.
    pub fn between(one: &Picture, two: &Picture) -> Self {
        if (one.width, one.height) != (two.width, two.height) {
            return Self { mean: 255.0, outliers: 1.0 };
        }
        let (mut sum, mut outliers) = (0u64, 0u64);
        for (a, b) in one.rgba.chunks_exact(4).zip(two.rgba.chunks_exact(4)) {
            let differences = [0, 1, 2].map(|channel| a[channel].abs_diff(b[channel]));
            sum += differences.iter().map(|difference| u64::from(*difference)).sum::<u64>();
            outliers += u64::from(differences.iter().any(|difference| *difference > 32));
        }
        let pixels = f64::from(one.width) * f64::from(one.height);
        Self { mean: sum as f64 / (3.0 * pixels), outliers: outliers as f64 / pixels }
    }

    /// Whether the difference is no more than drivers may differ by.
    #[must_use]
    pub fn is_tolerable(&self) -> bool {
        self.mean <= TOLERANCE.mean && self.outliers <= TOLERANCE.outliers
    }
}

/// Compares a picture with the golden one of a name, or writes that one when blessing.
///
/// # Errors
/// One line that says how different the pictures are and where the new one lies.
pub fn check(name: &str, picture: &Picture) -> Result<(), String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("golden").join(format!("{name}.png"));
    if std::env::var_os("TOMBOLO_BLESS").is_some() {
        return write(&path, picture);
    }
    let golden =
        image::open(&path).map_err(|error| format!("cannot read {}: {error}", path.display()))?.to_rgba8();
    let golden = Picture { width: golden.width(), height: golden.height(), rgba: golden.into_raw() };
    let difference = Difference::between(&golden, picture);
    if difference.is_tolerable() {
        return Ok(());
    }
    let drawn = drawn_path(name);
    write(&drawn, picture)?;
    Err(format!(
        "{name} differs from its golden picture: {difference:?} against {TOLERANCE:?}; see {}",
        drawn.display()
    ))
}

fn drawn_path(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("tombolo-{name}-drawn.png"))
}

fn write(path: &Path, picture: &Picture) -> Result<(), String> {
    image::save_buffer(path, &picture.rgba, picture.width, picture.height, image::ColorType::Rgba8)
        .map_err(|error| format!("cannot write {}: {error}", path.display()))
}
