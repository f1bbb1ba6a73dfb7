//! `--textures`: a folder of images becomes material sets.
//!
//! Each invalid or missing file gives a one-line warning with its substitute; none is an error.
//! Images are untrusted: size and decoder memory are limited before allocation.

use crate::features::materials::{CustomMaterial, CustomMaterials, MATERIAL_SIZE, MATERIAL_TEXELS};
use crate::native::args::Args;
use crate::native::png_file::{self, Pixels};
use cli::UsageError;
use shaders::layout::{BakeTexel, MATERIALS};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Squares of the checker along a side.
const CHECKS: usize = 16;

/// The maps of a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Map {
    Albedo,
    Normal,
    Height,
    Roughness,
    Occlusion,
}

impl Map {
    const ALL: [Self; 5] = [Self::Albedo, Self::Normal, Self::Height, Self::Roughness, Self::Occlusion];

    /// File name suffixes after the set name and an underscore; the first one is preferred.
    const fn names(self) -> &'static [&'static str] {
        match self {
            Self::Albedo => &["albedo", "basecolor", "base_color", "diffuse", "diff", "color", "col"],
            Self::Normal => &["normal", "normalgl", "normal_gl", "nor_gl", "nrm"],
            Self::Height => &["height", "displacement", "disp"],
            Self::Roughness => &["roughness", "rough"],
            Self::Occlusion => &["ao", "ambientocclusion", "ambient_occlusion", "occlusion"],
        }
    }

    /// Substitute for a missing map.
    const fn substitute(self) -> &'static str {
        match self {
            Self::Albedo => "a checker",
            Self::Normal => "normals from the height",
            Self::Height => "a flat height",
            Self::Roughness => "roughness 0.9",
            Self::Occlusion => "occlusion from the height",
        }
    }
}

/// The sets of the options; warnings go to standard error.
///
/// # Errors
/// The folder itself cannot be read.
pub fn custom_materials(args: &Args) -> Result<CustomMaterials, UsageError> {
    let Some(folder) = &args.textures else { return Ok(CustomMaterials::default()) };
    let (materials, warnings) = load(folder)?;
    for warning in warnings {
        eprintln!("{warning}");
    }
    Ok(materials)
}

/// Reads a folder: the sets with at least one file, and a warning for each invalid or missing file.
///
/// # Errors
/// The folder itself cannot be read.
pub fn load(folder: &Path) -> Result<(CustomMaterials, Vec<String>), UsageError> {
    let unreadable = |error: std::io::Error| {
        let line = "name a folder of files such as sand_albedo.png";
        UsageError::new(format!("cannot read --textures {}: {line}: {error}", folder.display()))
    };
    let mut files: [BTreeMap<Map, PathBuf>; MATERIALS.len()] = Default::default();
    let mut warnings = Vec::new();
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        paths.push(entry.map_err(unreadable)?.path());
    }
    // Directory order is arbitrary; the selected file must not depend on it.
    paths.sort();
    for path in paths {
        let Some((material, map)) = classify(&path) else { continue };
        if let Some(taken) = files[material].get(&map) {
            warnings.push(format!(
                "{}: {} is another file for this map and is used",
                path.display(),
                taken.file_name().unwrap_or_default().display()
            ));
        } else {
            files[material].insert(map, path);
        }
    }
    if files.iter().all(BTreeMap::is_empty) {
        warnings.push(format!(
            "{}: no file is named like sand_albedo.png (--help has all names), using no custom materials",
            folder.display()
        ));
    }
    let mut index = 0;
    let materials = files.map(|files| {
        let name = MATERIALS[index];
        index += 1;
        (!files.is_empty()).then(|| assemble(folder, name, &files, &mut warnings))
    });
    Ok((CustomMaterials::new(materials), warnings))
}

/// Set and map of a file name; case-insensitive.
fn classify(path: &Path) -> Option<(usize, Map)> {
    let stem = path.file_stem()?.to_str()?.to_ascii_lowercase().replace('-', "_");
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    if extension != "png" {
        return None;
    }
    MATERIALS.iter().enumerate().find_map(|(index, material)| {
        let rest = stem.strip_prefix(material)?.strip_prefix('_')?;
        let map = Map::ALL.into_iter().find(|map| map.names().contains(&rest))?;
        Some((index, map))
    })
}

/// Builds a set from its files, with substitutes for missing maps.
fn assemble(
    folder: &Path,
    material: &str,
    files: &BTreeMap<Map, PathBuf>,
    warnings: &mut Vec<String>,
) -> CustomMaterial {
    let mut read = |map: Map| {
        let Some(path) = files.get(&map) else {
            let path = folder.join(format!("{material}_{}.png", map.names()[0]));
            warnings.push(format!("{}: the file does not exist, using {}", path.display(), map.substitute()));
            return None;
        };
        match png_file::read(path) {
            Ok(image) => Some(resampled(&image, map == Map::Albedo)),
            Err(cause) => {
                warnings.push(format!("{}: {cause}, using {}", path.display(), map.substitute()));
                None
            }
        }
    };
    let [albedo, normal, height, roughness, occlusion] = Map::ALL.map(&mut read);
    let texels = (0..MATERIAL_TEXELS).map(|at| {
        let grey = |image: &Option<Vec<[f32; 3]>>, missing: f32| {
            image.as_ref().map_or(missing, |image| image[at][0])
        };
        BakeTexel {
            albedo: albedo.as_ref().map_or_else(|| checker(at), |albedo| albedo[at]),
            height: grey(&height, 0.5),
            // Green points up in images and v points down in textures.
            normal: normal.as_ref().map_or([0.0; 2], |normal| unit_part(normal[at])),
            roughness: grey(&roughness, 0.9),
            occlusion: grey(&occlusion, 1.0),
        }
    });
    CustomMaterial {
        texels: texels.collect(),
        normals_given: normal.is_some(),
        occlusion_given: occlusion.is_some(),
    }
}

/// Magenta and black squares, easy to notice.
fn checker(at: usize) -> [f32; 3] {
    let side = MATERIAL_SIZE as usize;
    let grid = |place: usize| place * CHECKS / side;
    if (grid(at % side) + grid(at / side)).is_multiple_of(2) { [0.8, 0.0, 0.8] } else { [0.02; 3] }
}

/// The horizontal part of an encoded normal, normalized after filtering.
fn unit_part(encoded: [f32; 3]) -> [f32; 2] {
    let [x, y, z] = encoded.map(|channel| channel.mul_add(2.0, -1.0));
    let z = z.max(0.05);
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, -y / length]
}

/// Pixels in [0, 1] at texture size; `colour` ones are decoded from sRGB first. Averages larger
/// images, interpolates smaller ones; edges wrap, because textures repeat.
fn resampled(image: &Pixels, colour: bool) -> Vec<[f32; 3]> {
    let (width, height) = (image.width, image.height);
    let side = MATERIAL_SIZE as usize;
    let pixel = |x: usize, y: usize| {
        let channels = image.rgb(x, y);
        if colour { channels.map(linear) } else { channels }
    };
    let across = taps(width, side);
    let down = taps(height, side);
    let weighted = |line: &[[f32; 3]], taps: &[(usize, f32)]| {
        taps.iter().fold([0.0; 3], |sum: [f32; 3], &(at, share)| {
            std::array::from_fn(|channel| line[at][channel].mul_add(share, sum[channel]))
        })
    };
    // Along rows, then down columns, so that each pixel is decoded once; a float copy of one row at
    // a time.
    let rows = (0..height).map(|y| {
        let row: Vec<_> = (0..width).map(|x| pixel(x, y)).collect();
        across.iter().map(|taps| weighted(&row, taps)).collect::<Vec<_>>()
    });
    let rows: Vec<_> = rows.collect();
    let mut out = vec![[0.0; 3]; MATERIAL_TEXELS];
    for x in 0..side {
        let column: Vec<_> = rows.iter().map(|row| row[x]).collect();
        for (y, taps) in down.iter().enumerate() {
            out[y * side + x] = weighted(&column, taps);
        }
    }
    out
}

/// Filter taps: for each of `to` positions the samples of `from` and their weights, which sum to 1.
fn taps(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let scale = from as f64 / to as f64;
    let place = |index: usize| {
        let centre = (index as f64 + 0.5) * scale - 0.5;
        // A tent filter as wide as the coarser grid: interpolates upward, averages downward.
        let radius = scale.max(1.0);
        let low = (centre - radius).ceil() as i64;
        let high = (centre + radius).floor() as i64;
        let shares: Vec<(usize, f64)> = (low..=high)
            .map(|at| (at.rem_euclid(from as i64) as usize, 1.0 - (at as f64 - centre).abs() / radius))
            .collect();
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.into_iter().map(|(at, share)| (at, (share / total) as f32)).collect()
    };
    (0..to).map(place).collect()
}

/// The inverse sRGB transfer function (IEC 61966-2-1).
fn linear(encoded: f32) -> f32 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, ImageBuffer, Luma, Rgb, RgbImage};

    /// A folder that goes when the test ends.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("tombolo-textures-{}-{name}", std::process::id()));
            std::fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn path(&self, name: &str) -> PathBuf {
            self.0.join(name)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn material<'a>(own: &'a CustomMaterials, name: &str) -> Option<&'a CustomMaterial> {
        own[MATERIALS.iter().position(|known| *known == name).unwrap()].as_ref()
    }

    /// A set of which every file is there and good.
    fn complete(folder: &Folder) {
        RgbImage::from_pixel(7, 3, Rgb([255, 0, 188])).save(folder.path("sand_BaseColor.png")).unwrap();
        RgbImage::from_pixel(2, 2, Rgb([128, 128, 255])).save(folder.path("sand_normal.png")).unwrap();
        let tall: ImageBuffer<Luma<u16>, Vec<u16>> =
            ImageBuffer::from_fn(1024, 1024, |x, _| Luma([if x < 512 { 1 } else { 65_535 }]));
        tall.save(folder.path("sand_displacement.png")).unwrap();
        GrayImage::from_pixel(1, 1, Luma([51])).save(folder.path("sand_roughness.png")).unwrap();
        GrayImage::from_pixel(512, 512, Luma([204])).save(folder.path("sand_ao.png")).unwrap();
    }

    #[test]
    fn a_complete_set_of_any_size_and_depth_is_taken_without_a_word() {
        let folder = Folder::new("complete");
        complete(&folder);
        let (own, warnings) = load(&folder.0).unwrap();
        assert_eq!(warnings, Vec::<String>::new());
        assert_eq!(own.iter().flatten().count(), 1, "the other sets stay procedural");
        let sand = material(&own, "sand").unwrap();
        assert!(sand.normals_given && sand.occlusion_given && sand.texels.len() == MATERIAL_TEXELS);
        let texel = sand.texels[MATERIAL_SIZE as usize / 4];
        let near = |a: f32, b: f32| (a - b).abs() < 0.005;
        assert!(near(texel.albedo[0], 1.0) && near(texel.albedo[1], 0.0), "{texel:?}");
        assert!(near(texel.albedo[2], 0.503), "sRGB 188 is half the light: {texel:?}");
        assert!(near(texel.roughness, 0.2) && near(texel.occlusion, 0.8), "{texel:?}");
        // 16 bits survive: 1 of 65535 is not 0.
        assert!(texel.height > 1e-5 && texel.height < 2e-5, "{}", texel.height);
        assert!(near(sand.texels[3 * MATERIAL_SIZE as usize / 4].height, 1.0));
        assert!(texel.normal.iter().all(|part| part.abs() < 0.005), "{texel:?}");
    }

    #[test]
    fn bad_and_missing_files_are_named_and_a_bad_albedo_is_a_checker() {
        let folder = Folder::new("bad");
        complete(&folder);
        let whole = std::fs::read(folder.path("sand_BaseColor.png")).unwrap();
        std::fs::write(folder.path("cliff_albedo.png"), &whole[..whole.len() / 2]).unwrap();
        std::fs::write(folder.path("scree_color.png"), b"not an image").unwrap();
        std::fs::write(folder.path("meadow_diffuse.png"), []).unwrap();
        std::fs::create_dir(folder.path("cobbles_albedo.png")).unwrap();
        GrayImage::from_pixel(1, 1, Luma([9])).save(folder.path("thicket_height.png")).unwrap();
        std::fs::write(folder.path("notes.txt"), b"not asked for").unwrap();
        let (own, warnings) = load(&folder.0).unwrap();
        for name in ["cliff", "scree", "meadow", "cobbles", "thicket"] {
            let own = material(&own, name).unwrap();
            let colours: std::collections::BTreeSet<_> =
                own.texels.iter().map(|texel| texel.albedo.map(f32::to_bits)).collect();
            assert_eq!(colours.len(), 2, "{name} is no checker");
            let said = warnings.iter().filter(|line| line.contains(&format!("{name}_")));
            // Every map but the one height that is good.
            assert_eq!(said.count(), if name == "thicket" { 4 } else { 5 }, "{warnings:?}");
        }
        assert!(material(&own, "dry_grass").is_none());
        assert!(
            warnings.iter().all(|line| !line.contains('\n') && line.contains(", using ")),
            "{warnings:?}"
        );
        assert!(
            warnings
                .iter()
                .any(|line| line.contains("thicket_albedo.png: the file does not exist, using a checker"))
        );
        let sand = material(&own, "sand").unwrap();
        assert_ne!(sand.texels[0].albedo, checker(0), "the control: a good albedo is no checker");
    }

    /// A test that waits for the pipe would never end.
    #[cfg(unix)]
    #[test]
    fn a_named_pipe_is_refused_without_waiting_for_its_writer() {
        let folder = Folder::new("pipe");
        complete(&folder);
        let pipe = folder.path("cobbles_height.png");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.is_ok_and(|status| status.success()), "mkfifo is part of every Unix");
        let (own, warnings) = load(&folder.0).unwrap();
        let said: Vec<_> = warnings.iter().filter(|line| line.contains("cobbles_height.png")).collect();
        assert!(said.len() == 1 && said[0].contains("no regular file"), "{warnings:?}");
        assert!(material(&own, "sand").is_some(), "the control: regular files are read");
    }

    #[test]
    fn an_image_that_claims_to_be_huge_is_refused_before_it_takes_memory() {
        let folder = Folder::new("huge");
        complete(&folder);
        let mut claim = std::fs::read(folder.path("sand_BaseColor.png")).unwrap();
        // Width and height of the header, and its checksum (CRC-32 of chunk type and data; PNG,
        // section 5.3).
        claim[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
        let crc = !claim[12..29].iter().fold(!0u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
                (crc >> 1) ^ (0xedb8_8320 & 0u32.wrapping_sub(crc & 1))
            })
        });
        claim[29..33].copy_from_slice(&crc.to_be_bytes());
        std::fs::write(folder.path("sand_BaseColor.png"), claim).unwrap();
        let (own, warnings) = load(&folder.0).unwrap();
        assert!(warnings.len() == 1 && warnings[0].contains("sand_BaseColor.png"), "{warnings:?}");
        assert_eq!(material(&own, "sand").unwrap().texels[0].albedo, checker(0));
    }

    #[test]
    fn a_folder_without_a_known_name_is_said_and_changes_nothing() {
        let folder = Folder::new("strange");
        std::fs::write(folder.path("lava_albedo.png"), b"no known set").unwrap();
        let (own, warnings) = load(&folder.0).unwrap();
        assert_eq!(own.iter().flatten().count(), 0);
        assert!(warnings.len() == 1 && warnings[0].contains("like sand_albedo.png"), "{warnings:?}");
    }

    #[test]
    fn a_folder_that_is_not_there_is_an_error_with_its_name() {
        let error = load(Path::new("/no/such/folder")).unwrap_err().to_string();
        assert!(error.contains("/no/such/folder") && error.contains("--textures"), "{error}");
    }

    #[test]
    fn two_files_for_one_map_give_a_warning_and_sets_are_known_by_name() {
        let folder = Folder::new("two");
        for name in ["sand_albedo.png", "sand_color.png"] {
            RgbImage::from_pixel(1, 1, Rgb([1, 2, 3])).save(folder.path(name)).unwrap();
        }
        let (_, warnings) = load(&folder.0).unwrap();
        assert!(
            warnings[0].contains("sand_color.png") && warnings[0].contains("sand_albedo.png"),
            "{warnings:?}"
        );
        let known = |name: &str| classify(Path::new(name)).map(|(at, map)| (MATERIALS[at], map));
        assert_eq!(known("Dry_Grass-Normal.PNG"), Some(("dry_grass", Map::Normal)));
        assert_eq!(known("sand.png"), None);
        assert_eq!(known("lava_albedo.png"), None);
        assert_eq!(known("sand_albedo.tiff"), None);
    }

    #[test]
    fn resampling_keeps_the_mean_and_wraps() {
        for from in [1, 3, 512, 700, 4096] {
            let taps = taps(from, 512);
            let mut weights = vec![0.0; from];
            for (at, share) in taps.iter().flatten() {
                weights[*at] += share;
            }
            let expected = 512.0 / from as f32;
            assert!(weights.iter().all(|weight| (weight / expected - 1.0).abs() < 0.35), "{from}");
            assert!(
                taps.iter().all(|taps| (taps.iter().map(|(_, share)| share).sum::<f32>() - 1.0).abs() < 1e-5)
            );
        }
        // The first texel of a doubled image is a blend with the last one.
        assert!(taps(256, 512)[0].iter().any(|(at, _)| *at == 255));
    }
}
