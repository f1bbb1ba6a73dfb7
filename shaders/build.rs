//! Links every pass with its shared modules, validates it and writes `SHADERS` as Rust.
//!
//! A pass is a file directly under `wgsl/`, a shared module one under `wgsl/shared/`; modules under
//! `wgsl/bound/` may declare bindings, for passes that read the same buffers. The shared module
//! `constants` is no file: it is written here from `terrain::constants`, so no number exists twice.
//! Errors of all passes are collected before the build fails.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

use terrain::base::LATTICES;
use terrain::constants as land;
use terrain::pyramid::PYRAMID_TEXELS;
use terrain::spline;
use wesl::syntax::{ModulePath, PathOrigin};
use wesl::{ManglerKind, VirtualResolver, Wesl};

#[path = "src/validate.rs"]
mod validate;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=wgsl");
    println!("cargo::rerun-if-changed=src/validate.rs");

    let passes = sources(Path::new("wgsl"))?;
    let mut modules = vec![(module_path(&["shared", "constants"]), constants())];
    for folder in ["shared", "bound"] {
        for (stem, source) in sources(&Path::new("wgsl").join(folder))? {
            modules.push((module_path(&[folder, &stem]), source));
        }
    }

    let mut linked = Vec::new();
    let mut complaints = Vec::new();
    for (stem, source) in passes {
        match link(&stem, &source, &modules).and_then(|wgsl| {
            let (module, _) = validate::validate(&stem, &wgsl)?;
            Ok((wgsl, module))
        }) {
            Ok((wgsl, module)) => linked.push((stem, wgsl, module)),
            Err(complaint) => complaints.push(format!("{stem}.wesl: {complaint}")),
        }
    }
    if !complaints.is_empty() {
        return Err(complaints.join("\n").into());
    }

    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set: run by cargo")?);
    fs::write(out.join("shaders.rs"), rust_source(&linked)?)?;
    Ok(())
}

/// Stem and text of each `.wesl` file directly in a folder, sorted so that builds are reproducible.
fn sources(folder: &Path) -> Result<Vec<(String, String)>, Box<dyn Error>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "wesl") {
            let stem = path.file_stem().ok_or("a shader file without a name")?.to_string_lossy().into_owned();
            found.push((stem, fs::read_to_string(&path)?));
        }
    }
    found.sort();
    Ok(found)
}

fn module_path(parts: &[&str]) -> ModulePath {
    ModulePath::new(PathOrigin::Absolute, parts.iter().map(|part| (*part).to_owned()).collect())
}

/// The WGSL form of what the shaders need from `terrain::constants`.
fn constants() -> String {
    let mut text = String::new();
    for (name, value) in [
        ("CELLS", land::CELLS),
        ("VERTICES", land::VERTICES),
        ("VERTEX_COUNT", land::VERTEX_COUNT),
        ("PYRAMID_TEXELS", PYRAMID_TEXELS),
        ("OCTAVES", land::OCTAVES),
        ("BASE_OCTAVES", land::BASE_OCTAVES),
        ("FINE_OCTAVES", land::FINE_OCTAVES),
        ("LATTICES", LATTICES),
    ] {
        text += &format!("const {name}: u32 = {value}u;\n");
    }
    for (name, value) in [
        ("UNIT_BITS", land::UNIT_BITS),
        ("BASE_CELL_BITS", land::BASE_CELL_BITS),
        ("BASE_STREAM", land::BASE_STREAM),
        ("WARP_STREAM", land::WARP_STREAM),
        ("EXPOSURE_STREAM", land::EXPOSURE_STREAM),
        ("EXPOSURE_CELL_BITS", land::EXPOSURE_CELL_BITS),
        ("FIRST_CELL_BITS", land::FIRST_CELL_BITS),
        ("FIRST_AMPLITUDE_BITS", land::FIRST_AMPLITUDE_BITS),
        ("FRACTION_BITS", land::FRACTION_BITS),
        ("FINE_BITS", land::FINE_BITS),
        ("ISLAND_CELL_BITS", land::ISLAND_CELL_BITS),
        ("SPLINE_CELL_BITS", spline::CELL_BITS),
    ] {
        text += &format!("const {name}: u32 = {value}u;\n");
    }
    for (name, value) in [
        ("WORLD_HALF", land::WORLD_HALF),
        ("SEA_FLOOR_M", land::SEA_FLOOR_M),
        ("WARP_M", land::WARP_M),
        ("RIM_M", land::RIM_M),
        ("UPLIFT_M", land::UPLIFT_M),
        ("MOUNTAIN_M", land::MOUNTAIN_M),
        ("HOME_LOBE_M", land::HOME_LOBE_M),
        ("BEACH_M", land::BEACH_M),
        ("CLIFF_M", land::CLIFF_M),
        ("CLIFF_FOOT_M", land::CLIFF_FOOT_M),
    ] {
        text += &format!("const {name}: i32 = {value};\n");
    }
    let [wide, narrow] = land::WARP_CELL_BITS;
    text += &format!("const WARP_CELL_BITS: vec2u = vec2u({wide}u, {narrow}u);\n");
    let [wide, narrow] = land::WARP_AMPLITUDE_M;
    text += &format!("const WARP_AMPLITUDE_M: vec2i = vec2i({wide}, {narrow});\n");
    let [a, b, c, d] = land::SHORE_M;
    text += &format!("const SHORE_M: vec4i = vec4i({a}, {b}, {c}, {d});\n");
    let gradients = land::GRADIENTS.map(|(x, z)| (i32::from(x), i32::from(z)));
    text += &table("GRADIENTS", &gradients);
    text += &table("OCTAVE_SHIFT", &land::OCTAVE_SHIFT);
    text += &format!("const METRES_PER_UNIT: f32 = {:?};\n", 1.0 / f64::from(land::UNITS_PER_METRE));
    text
}

/// A WGSL constant of pairs.
fn table(name: &str, pairs: &[(i32, i32)]) -> String {
    let rows = pairs.iter().map(|(x, z)| format!("vec2i({x}, {z})")).collect::<Vec<_>>().join(", ");
    format!("const {name} = array<vec2i, {}>({rows});\n", pairs.len())
}

/// One self-contained WGSL source. Names stay as written: two modules with the same name are an
/// error that naga reports, and a capture in a graphics debugger stays readable.
fn link(stem: &str, source: &str, modules: &[(ModulePath, String)]) -> Result<String, String> {
    let mut resolver = VirtualResolver::new();
    for (path, text) in modules {
        resolver.add_module(path.clone(), text.into());
    }
    let root = module_path(&[stem]);
    resolver.add_module(root.clone(), source.into());
    let mut linker = Wesl::new_barebones().set_custom_resolver(resolver);
    linker.set_options(wesl::CompileOptions::default()).set_mangler(ManglerKind::None).use_sourcemap(true);
    Ok(linker.compile(&root).map_err(|error| error.to_string())?.to_string())
}

fn rust_source(linked: &[(String, String, naga::Module)]) -> Result<String, std::fmt::Error> {
    let (mut fields, mut values) = (String::new(), String::new());
    for (stem, wgsl, module) in linked {
        let summary = format!("`wgsl/{stem}.wesl`, linked.");
        writeln!(fields, "    /// {summary}\n    pub {stem}: Shader,")?;
        let entries = module
            .entry_points
            .iter()
            .map(|entry| format!("EntryPoint {{ name: {:?}, stage: Stage::{:?} }}", entry.name, entry.stage))
            .collect::<Vec<_>>()
            .join(", ");
        writeln!(
            values,
            "    {stem}: Shader {{ name: {stem:?}, wgsl: {wgsl:?}, entry_points: &[{entries}] }},"
        )?;
    }
    let list = linked.iter().map(|(stem, ..)| format!("&self.{stem}")).collect::<Vec<_>>().join(", ");
    let count = linked.len();
    Ok(format!(
        "/// Every pass.\npub struct Shaders {{\n{fields}}}\n\n\
         /// Every pass, linked and validated when this crate was built.\n\
         pub static SHADERS: Shaders = Shaders {{\n{values}}};\n\n\
         impl Shaders {{\n    /// All passes, by name.\n    #[must_use]\n    \
         pub fn all(&self) -> [&Shader; {count}] {{\n        [{list}]\n    }}\n}}\n"
    ))
}
