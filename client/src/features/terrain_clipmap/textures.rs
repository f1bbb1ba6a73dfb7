//! The textures of the clipmap, and what the shaders need to read them.

use super::heights::Heights;
use super::schedule::{Schedule, Tile};
use super::sky_visibility::{SKY_TEXELS, sky_visibility};
use super::window::{ClipmapSize, FINEST_SPACING_M, TILE_TEXELS, chunk_of};
use crate::camera::Eye;
use crate::gpu::bind;
use crate::gpu::buffer::create_buffer;
use half::f16;
use shaders::layout::Clipmap;
use terrain::constants::{CELLS, UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use terrain::land::SEA_FLOOR;
use terrain::{Land, WorldDigest};

/// Most tiles that an interactive frame fills, so that a frame never waits for a whole level. More
/// wait for the next frames; until then a coarser level is used.
pub const TILES_PER_FRAME: usize = 4;

/// Fills everything: for still images.
pub const ALL_TILES: usize = usize::MAX;

/// Slopes east and south. Filterable on every device; eleven bits of precision at any slope.
const SLOPE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rg16Float;

/// Heights above the sea, metres. No half float holds them; the shaders blend them themselves,
/// because WebGPU does not filter this format by default.
const HEIGHT_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;

/// Sky visibility.
const SKY_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R8Unorm;

/// The land of a clipmap, and the factor of its heights.
#[derive(Clone, Copy, Debug)]
pub struct ClipmapLand {
    /// The land.
    pub land: Land,
    /// Its digest.
    pub digest: WorldDigest,
    /// Vertical scale of what is drawn.
    pub vertical_scale: f32,
}

/// The clipmap.
#[derive(Debug)]
pub struct TerrainClipmap {
    size: ClipmapSize,
    maps: Maps,
    params: wgpu::Buffer,
    layout: wgpu::BindGroupLayout,
    bindings: wgpu::BindGroup,
    source: Option<Source>,
}

/// The textures: a layer for each level.
#[derive(Debug)]
struct Maps {
    slopes: wgpu::Texture,
    sky: wgpu::Texture,
    heights: wgpu::Texture,
}

/// Source of the tiles.
#[derive(Debug)]
struct Source {
    digest: WorldDigest,
    /// Of the heights.
    scale: f32,
    heights: Heights,
    schedule: Schedule,
}

impl TerrainClipmap {
    /// An empty clipmap.
    #[must_use]
    pub fn new(device: &wgpu::Device, size: ClipmapSize) -> Self {
        let texture = |label, format, side| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: size.levels },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                view_formats: &[],
            })
        };
        let maps = Maps {
            slopes: texture("clipmap slopes", SLOPE_FORMAT, size.texels()),
            sky: texture("clipmap sky visibility", SKY_FORMAT, size.side_tiles * SKY_TEXELS as u32),
            heights: texture("clipmap heights", HEIGHT_FORMAT, size.texels()),
        };
        let params = create_buffer(
            device,
            "clipmap",
            size_of::<Clipmap>() as u64,
            wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        );
        let layout = bind::layout(device, "clipmap", &Self::layout_entries());
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("clipmap"),
            // The address of a texel wraps around.
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        // An array even of one level: the shaders declare one.
        let array = wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        };
        let views = [&maps.slopes, &maps.sky, &maps.heights].map(|map| map.create_view(&array));
        let resources = [
            params.as_entire_binding(),
            wgpu::BindingResource::TextureView(&views[0]),
            wgpu::BindingResource::TextureView(&views[1]),
            wgpu::BindingResource::Sampler(&sampler),
            wgpu::BindingResource::TextureView(&views[2]),
        ];
        let bindings = bind::bind(device, "clipmap", &layout, &resources);
        Self { size, maps, params, layout, bindings, source: None }
    }

    fn layout_entries() -> [wgpu::BindGroupLayoutEntry; 5] {
        let (stages, array) = (wgpu::ShaderStages::VERTEX_FRAGMENT, wgpu::TextureViewDimension::D2Array);
        [
            bind::uniform_entry(0),
            bind::texture_entry(1, stages, array, true),
            bind::texture_entry(2, stages, array, true),
            bind::sampler_entry(3, stages),
            bind::texture_entry(4, stages, array, false),
        ]
    }

    /// Layout of its bind group.
    #[must_use]
    pub fn layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// Its bind group: parameters, slopes, sky visibility, sampler, heights.
    #[must_use]
    pub fn bindings(&self) -> &wgpu::BindGroup {
        &self.bindings
    }

    /// Fills at most `most` tiles around an eye, as far as the view distance, and uploads the
    /// parameters. Without a land nothing is filled, and the shaders use the slopes of the drawn
    /// chunks. Returns the number of tiles.
    pub fn update(
        &mut self,
        queue: &wgpu::Queue,
        eye: &Eye,
        land: Option<&ClipmapLand>,
        view_distance_m: u32,
        most: usize,
    ) -> usize {
        let Some(land) = land else {
            queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&Clipmap::NONE));
            return 0;
        };
        let scale = land.vertical_scale;
        let is_of =
            |source: &Source| source.digest == land.digest && source.scale.to_bits() == scale.to_bits();
        if !self.source.as_ref().is_some_and(is_of) {
            let (heights, schedule) = (Heights::new(land.land, scale), Schedule::new(self.size));
            self.source = Some(Source { digest: land.digest, scale, heights, schedule });
        }
        let Some(source) = &mut self.source else { return 0 };
        let levels = self.size.levels_for(view_distance_m);
        let tiles = source.schedule.next(eye, levels, most);
        for tile in &tiles {
            fill(queue, &self.maps, self.size, &mut source.heights, *tile);
        }
        let params = params(self.size, levels, &source.schedule, eye, land.vertical_scale);
        queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&params));
        tiles.len()
    }
}

/// The parameters of a frame.
fn params(size: ClipmapSize, levels: u32, schedule: &Schedule, eye: &Eye, vertical_scale: f32) -> Clipmap {
    let mut params = Clipmap {
        count: levels,
        vertical_scale,
        reach_m: size.reach_m(0) as f32,
        spacing_m: FINEST_SPACING_M as f32,
        texels: size.texels() as f32,
        ..Clipmap::NONE
    };
    for (level, words) in params.levels.iter_mut().enumerate().take(levels as usize) {
        let side = size.spacing_m(level as u32) * f64::from(size.texels());
        let wrapped = |units: i32, fraction_m: f32| {
            let at_m = f64::from(units) / f64::from(UNITS_PER_METRE) + f64::from(fraction_m);
            (at_m / side).rem_euclid(1.0) as f32
        };
        let is_ready = schedule.is_ready(level as u32, eye);
        *words = [
            wrapped(eye.units[0], eye.fraction_m.x),
            wrapped(eye.units[2], eye.fraction_m.z),
            (1.0 / side) as f32,
            f32::from(u8::from(is_ready)),
        ];
    }
    params
}

/// The vertices of a chunk, units.
type Vertices = [i32; VERTEX_COUNT];

/// Heights of the low corners of the cells of a tile, metres above the sea: the vertices along the
/// other two borders belong to the next tiles. The sea floor outside the world.
fn heights_of(vertices: Option<&Vertices>) -> Vec<f32> {
    let metres = |units: i32| units as f32 / UNITS_PER_METRE as f32;
    let Some(vertices) = vertices else { return vec![metres(SEA_FLOOR); CELLS * CELLS] };
    let rows = vertices.chunks_exact(VERTICES).take(CELLS);
    rows.flat_map(|row| row[..CELLS].iter().map(|units| metres(*units))).collect()
}

/// Fills one tile.
fn fill(queue: &wgpu::Queue, maps: &Maps, size: ClipmapSize, heights: &mut Heights, tile: Tile) {
    let (column, row) = tile.place;
    let side = size.side_tiles as i32;
    let slot = [column.rem_euclid(side) as u32, row.rem_euclid(side) as u32];
    let write = |texture: &wgpu::Texture, texels: u32, texel_bytes: u32, bytes: &[u8]| {
        let origin = wgpu::Origin3d { x: slot[0] * texels, y: slot[1] * texels, z: tile.level };
        queue.write_texture(
            wgpu::TexelCopyTextureInfo { texture, mip_level: 0, origin, aspect: wgpu::TextureAspect::All },
            bytes,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(texels * texel_bytes),
                rows_per_image: None,
            },
            wgpu::Extent3d { width: texels, height: texels, depth_or_array_layers: 1 },
        );
    };
    let vertices = chunk_of(tile.level, tile.place).map(|key| heights.vertices(key));
    let vertices = vertices.as_deref();
    write(&maps.slopes, TILE_TEXELS, 4, bytemuck::cast_slice(&slopes_of(vertices, tile.level, size)));
    write(&maps.heights, TILE_TEXELS, 4, bytemuck::cast_slice(&heights_of(vertices)));
    write(&maps.sky, SKY_TEXELS as u32, 1, &sky_visibility(heights, tile.level, tile.place));
}

/// Slopes of the cells of a tile, metres per metre east and south: means over the cell, so they are
/// filtered as far as its spacing needs. Bits of half floats; level outside the world.
fn slopes_of(vertices: Option<&Vertices>, level: u32, size: ClipmapSize) -> Vec<[u16; 2]> {
    let Some(vertices) = vertices else { return vec![[0; 2]; CELLS * CELLS] };
    let scale = 1.0 / (2.0 * size.spacing_m(level) * f64::from(UNITS_PER_METRE)) as f32;
    let rows = vertices.chunks_exact(VERTICES).zip(vertices.chunks_exact(VERTICES).skip(1));
    rows.flat_map(|(north, south)| {
        north.windows(2).zip(south.windows(2)).map(|(north, south)| {
            let east = (north[1] - north[0]) + (south[1] - south[0]);
            let south = (south[0] - north[0]) + (south[1] - north[1]);
            [east, south].map(|rise| f16::from_f32(rise as f32 * scale).to_bits())
        })
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use terrain::Position;

    fn vertices_of(land: Land, tile: Tile) -> Box<Vertices> {
        Heights::new(land, 1.0).vertices(chunk_of(tile.level, tile.place).unwrap())
    }

    #[test]
    fn heights_are_those_of_the_land_at_the_low_corners_of_the_cells() {
        let land = Land::new(3);
        let heights = heights_of(Some(&*vertices_of(land, Tile { level: 0, place: (-7, 5) })));
        for (cell, height_m) in heights.iter().enumerate().step_by(191) {
            let at = |tile: i32, cell: usize| ((tile * 64 + cell as i32) * 2) * UNITS_PER_METRE;
            let place = Position::new(at(-7, cell % CELLS), at(5, cell / CELLS)).unwrap();
            assert_eq!(f64::from(*height_m), f64::from(land.height_at(place)) / 256.0, "{cell}");
        }
        assert!(heights.iter().any(|height_m| *height_m > 1.0), "land, or nothing is compared");
        assert_eq!(heights_of(None), vec![SEA_FLOOR as f32 / 256.0; CELLS * CELLS]);
    }

    #[test]
    fn slopes_are_those_of_the_cells_of_the_land() {
        let land = Land::new(3);
        let size = ClipmapSize::new(512, 20_000);
        let mut worst = 0.0_f64;
        let mut steepest = 0.0_f64;
        for level in 0..3 {
            let tile = Tile { level, place: (-7, 5) };
            let vertices = vertices_of(land, tile);
            let slopes = slopes_of(Some(&*vertices), level, size);
            let spacing = size.spacing_m(level);
            for (cell, slope) in slopes.iter().enumerate().step_by(191) {
                let corner = |east: i32, south: i32| {
                    let at = |tile: i32, cell: usize, more: i32| {
                        ((f64::from(tile) * 64.0 + cell as f64 + f64::from(more)) * spacing * 256.0) as i32
                    };
                    let place =
                        Position::new(at(-7, cell % CELLS, east), at(5, cell / CELLS, south)).unwrap();
                    f64::from(land.height_at(place)) / 256.0
                };
                let east = (corner(1, 0) - corner(0, 0) + corner(1, 1) - corner(0, 1)) / (2.0 * spacing);
                let south = (corner(0, 1) - corner(0, 0) + corner(1, 1) - corner(1, 0)) / (2.0 * spacing);
                worst = worst.max((east - f64::from(f16::from_bits(slope[0]).to_f32())).abs());
                worst = worst.max((south - f64::from(f16::from_bits(slope[1]).to_f32())).abs());
                steepest = steepest.max(east.abs());
            }
        }
        assert!(worst < 1e-3 && steepest > 0.2, "{worst} of {steepest}");
    }

    #[test]
    fn parameters_keep_a_fraction_of_a_texel_at_the_end_of_the_world() {
        let size = ClipmapSize::new(1024, 65_536);
        let eye: Eye = "4100000.37,10,-4100000.37,0,0".parse::<crate::camera::Pose>().unwrap().eye();
        let params = params(size, size.levels, &Schedule::new(size), &eye, 1.0);
        let [u, v, per_metre, is_ready] = params.levels[0];
        assert_eq!(is_ready, 0.0);
        assert!((f64::from(per_metre) * 2048.0 - 1.0).abs() < 1e-6);
        // 4,100,000.37 m are 2001.953 windows of 2,048 m.
        let expected = (4_100_000.37_f64 / 2048.0).fract();
        assert!((f64::from(u) - expected).abs() * 1024.0 < 0.01, "{u} {expected}");
        assert!((f64::from(v) - (1.0 - expected)).abs() * 1024.0 < 0.01, "{v}");
    }
}
