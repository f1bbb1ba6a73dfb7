//! FastNoise2: Perlin FBM over a uniform grid, f32, at a chosen SIMD level.
//!
//! Uses the bindings instead of the crate `fastnoise2`, for two reasons that both favour
//! FastNoise2: a level can be pinned, and no minimum and maximum are computed. [`as_shipped`] is
//! the crate as its users call it.

use super::{FIRST_CELL, GAIN, LACUNARITY, OCTAVES, SHIFT};
use crate::rounds::{Contender, Corner};
use anyhow::{Context, Result, ensure};
use fastnoise2::Node;
use fastnoise2_sys as sys;
use std::ffi::{CStr, c_char, c_int, c_void};

/// SIMD levels as FastSIMD counts them: one bit per instruction set, from bit 1 up to the newest
/// that is allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// x86, SSE to SSE4.1.
    Sse41 = (1 << 7) - 2,
    /// And SSE4.2, AVX, AVX2; the library compiles this level with FMA.
    Avx2 = (1 << 10) - 2,
    /// And AVX-512 F, VL, DQ, BW.
    Avx512 = (1 << 14) - 2,
}

/// Lets the library choose a level.
const AUTOMATIC: u32 = u32::MAX;

impl Level {
    /// Levels from slow to fast.
    pub const ALL: [Self; 3] = [Self::Sse41, Self::Avx2, Self::Avx512];

    /// Name of its contenders.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sse41 => "FastNoise2 SSE4.1",
            Self::Avx2 => "FastNoise2 AVX2",
            Self::Avx512 => "FastNoise2 AVX-512",
        }
    }

    /// Whether this CPU has it, as the library sees it.
    ///
    /// # Errors
    /// The library knows no Perlin noise.
    pub fn is_available(self) -> Result<bool> {
        let best = Generator::new("Perlin", AUTOMATIC)?.level();
        Ok(best & self as u32 == self as u32)
    }
}

/// A contender that fills a grid at a level.
///
/// # Errors
/// The library lacks a node or parameter, or chose another level.
pub fn contender<'a>(level: Level, columns: usize, rows: usize) -> Result<Contender<'a>> {
    let perlin = Generator::new("Perlin", level as u32)?;
    perlin.set_float("Feature Scale", FIRST_CELL as f32)?;
    let fbm = Generator::new("FractalFBm", level as u32)?;
    fbm.set_int("Octaves", OCTAVES as i32)?;
    fbm.set_float("Lacunarity", LACUNARITY)?;
    fbm.set_hybrid("Gain", GAIN)?;
    fbm.set_source("Source", &perlin)?;
    for generator in [&perlin, &fbm] {
        let got = generator.level();
        ensure!(got == level as u32, "{}: the library runs level {got:#x} instead", level.name());
    }
    Ok(Contender::new(level.name(), columns * rows, move |corner, out: &mut [f32]| {
        fbm.fill(corner, columns, out);
    }))
}

/// The crate as its users call it: it chooses the level and always computes minimum and maximum.
///
/// # Errors
/// The library lacks a node or parameter.
pub fn as_shipped<'a>(name: &str, columns: usize, rows: usize) -> Result<Contender<'a>> {
    let mut perlin = Node::from_name("Perlin")?;
    perlin.set("Feature Scale", FIRST_CELL as f32)?;
    let mut fbm = Node::from_name("FractalFBm")?;
    fbm.set("Octaves", OCTAVES as i32)?;
    fbm.set("Lacunarity", LACUNARITY)?;
    fbm.set("Gain", GAIN)?;
    fbm.set("Source", &perlin)?;
    Ok(Contender::new(name, columns * rows, move |corner: Corner, out: &mut [f32]| {
        let (x, z) = (corner.x as f32 + SHIFT, corner.z as f32 + SHIFT);
        let (columns, rows) = (columns as i32, rows as i32);
        assert_eq!(out.len(), (columns * rows) as usize);
        // SAFETY: the buffer holds `columns` times `rows` values, and the fractal's source is set.
        unsafe { fbm.gen_uniform_grid_2d_unchecked(out, x, z, columns, rows, 1.0, 1.0, 1) };
    }))
}

/// An owned node of the library. Its type is known by a number, its members by theirs.
struct Generator {
    handle: *mut c_void,
    kind: c_int,
}

impl Generator {
    fn new(kind: &str, level: u32) -> Result<Self> {
        // SAFETY: no arguments; numbers below the count name metadata that lives as long as the
        // program.
        let count = unsafe { sys::fnGetMetadataCount() };
        let found = (0..count).find(|id| is_named(unsafe { sys::fnGetMetadataName(*id) }, kind));
        let kind_id = found.with_context(|| format!("FastNoise2 has no generator `{kind}`"))?;
        // SAFETY: the number is one of the library's; any level is allowed, too high ones are not
        // created.
        let handle = unsafe { sys::fnNewFromMetadata(kind_id, level) };
        ensure!(!handle.is_null(), "FastNoise2 cannot create `{kind}` at level {level:#x}");
        Ok(Self { handle, kind: kind_id })
    }

    fn level(&self) -> u32 {
        // SAFETY: the handle lives as long as `self`, here and below.
        unsafe { sys::fnGetSIMDLevel(self.handle) }
    }

    fn set_float(&self, member: &str, value: f32) -> Result<()> {
        let index = self.member(member, sys::fnGetMetadataVariableCount, sys::fnGetMetadataVariableName)?;
        // SAFETY: as above; a member of another type is refused.
        accepted(unsafe { sys::fnSetVariableFloat(self.handle, index, value) }, member)
    }

    fn set_int(&self, member: &str, value: i32) -> Result<()> {
        let index = self.member(member, sys::fnGetMetadataVariableCount, sys::fnGetMetadataVariableName)?;
        // SAFETY: as above.
        accepted(unsafe { sys::fnSetVariableIntEnum(self.handle, index, value) }, member)
    }

    fn set_hybrid(&self, member: &str, value: f32) -> Result<()> {
        let index = self.member(member, sys::fnGetMetadataHybridCount, sys::fnGetMetadataHybridName)?;
        // SAFETY: as above.
        accepted(unsafe { sys::fnSetHybridFloat(self.handle, index, value) }, member)
    }

    fn set_source(&self, member: &str, source: &Self) -> Result<()> {
        let index =
            self.member(member, sys::fnGetMetadataNodeLookupCount, sys::fnGetMetadataNodeLookupName)?;
        // The library wants a pointer to its smart pointer, which is a plain pointer inside, unlike
        // everywhere else.
        let smart = (&raw const source.handle).cast();
        // SAFETY: as above; the library counts the reference to the source, so that it may be
        // dropped first.
        accepted(unsafe { sys::fnSetNodeLookup(self.handle, index, smart) }, member)
    }

    fn member(
        &self,
        name: &str,
        count: unsafe extern "C" fn(c_int) -> c_int,
        name_of: unsafe extern "C" fn(c_int, c_int) -> *const c_char,
    ) -> Result<c_int> {
        // SAFETY: the kind is one of the library's, the members are counted by itself.
        let found =
            (0..unsafe { count(self.kind) }).find(|i| is_named(unsafe { name_of(self.kind, *i) }, name));
        found.with_context(|| format!("FastNoise2 has no member `{name}` among the expected kind"))
    }

    fn fill(&self, corner: Corner, columns: usize, out: &mut [f32]) {
        let (x, z) = (corner.x as f32 + SHIFT, corner.z as f32 + SHIFT);
        let rows = out.len() / columns;
        // SAFETY: the library writes `columns` times `rows` values, which the slice holds. A null
        // pointer means no minimum and maximum.
        unsafe {
            sys::fnGenUniformGrid2D(
                self.handle,
                out.as_mut_ptr(),
                x,
                z,
                columns as c_int,
                rows as c_int,
                1.0,
                1.0,
                1,
                std::ptr::null_mut(),
            );
        }
    }
}

impl Drop for Generator {
    fn drop(&mut self) {
        // SAFETY: created by the library and given back once.
        unsafe { sys::fnDeleteNodeRef(self.handle) };
    }
}

fn is_named(name: *const c_char, wanted: &str) -> bool {
    // SAFETY: the library's names are static strings that end in zero.
    !name.is_null() && unsafe { CStr::from_ptr(name) }.to_bytes() == wanted.as_bytes()
}

fn accepted(answer: bool, member: &str) -> Result<()> {
    ensure!(answer, "FastNoise2 refuses the value for `{member}`");
    Ok(())
}

/// The C++ compiler of the library, from the signatures of the objects in this program; the last if
/// there are several.
///
/// # Errors
/// It is not clang: code of gcc is half as fast, which would favour the land.
pub fn compiler() -> Result<String> {
    const SIGNATURE: &[u8] = b"clang version ";
    let program = std::env::current_exe().and_then(std::fs::read).context("cannot read this program")?;
    let signatures = program.windows(SIGNATURE.len()).enumerate().filter(|(_, window)| *window == SIGNATURE);
    // The text searched for is in this program too, but no version follows it.
    let mut versions = signatures.filter_map(|(at, _)| {
        let rest = &program[at + SIGNATURE.len()..];
        let version = rest.iter().take_while(|c| c.is_ascii_digit() || **c == b'.').copied().collect();
        String::from_utf8(version).ok().filter(|version: &String| version.contains('.'))
    });
    versions.next_back().map(|version| format!("clang {version}")).context(
        "FastNoise2 was not built by clang; run `cargo clean --package fastnoise2-sys`, then build with \
         CC=clang-19 CXX=clang++-19",
    )
}
