//! Small PNG files: 256 colours by median cut (Heckbert, "Color Image Quantization for Frame Buffer
//! Display", SIGGRAPH 1982), on 5 bits a channel.

use anyhow::{Context, Result, ensure};
use png::{BitDepth, ColorType, Compression, Decoder, Encoder, Transformations};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, BufWriter, Write as _};
use std::path::Path;

const COLOURS: usize = 256;

type Rgb = [u8; 3];

/// Colours of one cell of the histogram: number of pixels and sums of their channels.
type Cell = (u64, [u64; 3]);

/// Writes a picture again with a palette.
///
/// # Errors
/// The picture cannot be read or written.
pub fn write(from: &Path, to: &Path) -> Result<()> {
    let (size, pixels) = read(from).with_context(|| format!("gallery: cannot read {}", from.display()))?;
    let (palette, indices) = reduced(&pixels);
    encode(to, size, &palette, &indices).with_context(|| format!("gallery: cannot write {}", to.display()))
}

fn read(path: &Path) -> Result<((u32, u32), Vec<Rgb>)> {
    let mut decoder = Decoder::new(BufReader::new(File::open(path)?));
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info()?;
    let mut data = vec![0; reader.output_buffer_size().context("it is too large")?];
    let frame = reader.next_frame(&mut data)?;
    ensure!(frame.bit_depth == BitDepth::Eight, "it has no 8 bits a channel");
    let channels = frame.color_type.samples();
    ensure!(channels >= 3, "it has no colours");
    let pixels =
        data[..frame.buffer_size()].chunks_exact(channels).map(|pixel| [pixel[0], pixel[1], pixel[2]]);
    Ok(((frame.width, frame.height), pixels.collect()))
}

fn encode(path: &Path, (width, height): (u32, u32), palette: &[Rgb], indices: &[u8]) -> Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    let mut encoder = Encoder::new(&mut file, width, height);
    encoder.set_color(ColorType::Indexed);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_palette(palette.concat());
    encoder.set_compression(Compression::High);
    // Indices of neighbours are not near each other.
    encoder.set_filter(png::Filter::NoFilter);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(indices)?;
    writer.finish()?;
    Ok(file.flush()?)
}

/// A palette of at most 256 colours, and the index of each pixel.
fn reduced(pixels: &[Rgb]) -> (Vec<Rgb>, Vec<u8>) {
    let cell_of = |pixel: &Rgb| pixel.map(|channel| channel >> 3);
    let mut histogram: BTreeMap<Rgb, Cell> = BTreeMap::new();
    for pixel in pixels {
        let (count, sums) = histogram.entry(cell_of(pixel)).or_default();
        *count += 1;
        sums.iter_mut().zip(pixel).for_each(|(sum, channel)| *sum += u64::from(*channel));
    }
    let mut boxes = vec![histogram.into_iter().collect::<Vec<_>>()];
    while boxes.len() < COLOURS {
        // The box with most pixels times its length, so that few pixels of rare colours keep one.
        let widest = |colours: &Vec<(Rgb, Cell)>| {
            let (channel, length) = longest(colours);
            (u64::from(length) * colours.iter().map(|(_, cell)| cell.0).sum::<u64>().isqrt(), channel)
        };
        let Some((index, (weight, channel))) =
            boxes.iter().map(widest).enumerate().max_by_key(|(_, (weight, _))| *weight)
        else {
            break;
        };
        if weight == 0 {
            break;
        }
        let mut low = boxes.swap_remove(index);
        low.sort_by_key(|(colour, _)| colour[channel]);
        let half = low.iter().map(|(_, cell)| cell.0).sum::<u64>() / 2;
        let mut sum = 0;
        let cut = low.iter().position(|(_, cell)| {
            sum += cell.0;
            sum > half
        });
        let high = low.split_off(cut.unwrap_or(1).clamp(1, low.len() - 1));
        boxes.extend([low, high]);
    }
    let mut palette = Vec::new();
    let mut index_of = BTreeMap::new();
    for (index, colours) in boxes.iter().enumerate() {
        let total = colours.iter().fold((0, [0; 3]), |(count, sums), (_, cell)| {
            (count + cell.0, [0, 1, 2].map(|channel| sums[channel] + cell.1[channel]))
        });
        palette.push(total.1.map(|sum: u64| (sum / total.0.max(1)) as u8));
        index_of.extend(colours.iter().map(|(colour, _)| (*colour, index as u8)));
    }
    let indices = pixels.iter().map(|pixel| index_of.get(&cell_of(pixel)).copied().unwrap_or(0)).collect();
    (palette, indices)
}

/// The channel in which colours differ most, and by how much.
fn longest(colours: &[(Rgb, Cell)]) -> (usize, u8) {
    let length = |channel: usize| {
        let values = || colours.iter().map(|(colour, _)| colour[channel]);
        values().max().unwrap_or(0) - values().min().unwrap_or(0)
    };
    let lengths = [0, 1, 2].map(|channel| (channel, length(channel)));
    lengths.into_iter().max_by_key(|(_, length)| *length).unwrap_or((0, 0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_colours_stay_and_many_become_near_ones() {
        let few: Vec<Rgb> = (0..900).map(|n| [[255, 0, 0], [0, 8, 255], [10, 200, 30]][n % 3]).collect();
        let (palette, indices) = reduced(&few);
        assert_eq!(palette.len(), 3);
        assert!(few.iter().zip(&indices).all(|(pixel, index)| palette[usize::from(*index)] == *pixel));
        let many: Vec<Rgb> =
            (0..64_000u32).map(|n| [(n % 251) as u8, (n / 251) as u8, (n * 7 % 241) as u8]).collect();
        let (palette, indices) = reduced(&many);
        assert_eq!(palette.len(), COLOURS);
        let error = many.iter().zip(&indices).map(|(pixel, index)| {
            let near = palette[usize::from(*index)];
            (0..3).map(|channel| u64::from(pixel[channel].abs_diff(near[channel]))).sum::<u64>()
        });
        let mean = error.sum::<u64>() as f64 / many.len() as f64;
        assert!(mean < 60.0, "{mean} of 765");
    }

    #[test]
    fn a_written_picture_has_the_same_pixels() {
        let folder = std::env::temp_dir();
        let path = folder.join(format!("tombolo-palette-{}.png", std::process::id()));
        let again = folder.join(format!("tombolo-palette-{}-again.png", std::process::id()));
        let palette = [[1, 2, 3], [200, 100, 50]];
        encode(&path, (3, 2), &palette, &[0, 1, 1, 0, 0, 1]).unwrap();
        write(&path, &again).unwrap();
        let (size, pixels) = read(&again).unwrap();
        std::fs::remove_file(path).unwrap();
        std::fs::remove_file(again).unwrap();
        let [a, b] = palette;
        assert_eq!((size, pixels), ((3, 2), vec![a, b, b, a, a, b]));
    }
}
