//! Links every pass with its shared modules, validates it and writes `SHADERS` as Rust.
//!
//! A pass is a file directly under `wgsl/`, a shared module one under `wgsl/shared/`. The shared module `constants` is
//! no file: it is written here from `terrain::constants`, so no number exists twice. Errors of all passes are collected
//! before the build fails.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

use terrain::constants::{CELLS, UNITS_PER_METRE, VERTEX_COUNT, VERTICES};
use wesl::syntax::{ModulePath, PathOrigin};
use wesl::{ManglerKind, VirtualResolver, Wesl};

#[path = "src/validate.rs"]
mod validate;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=wgsl");
    println!("cargo::rerun-if-changed=src/validate.rs");

    let passes = sources(Path::new("wgsl"))?;
    let mut modules = vec![(module_path(&["shared", "constants"]), constants())];
    for (stem, source) in sources(Path::new("wgsl/shared"))? {
        modules.push((module_path(&["shared", &stem]), source));
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
    let metres_per_unit = 1.0 / f64::from(UNITS_PER_METRE);
    format!(
        "const CELLS: u32 = {CELLS}u;\nconst VERTICES: u32 = {VERTICES}u;\nconst VERTEX_COUNT: u32 = {VERTEX_COUNT}u;\n\
         const METRES_PER_UNIT: f32 = {metres_per_unit:?};\n"
    )
}

/// One self-contained WGSL source. Names stay as written: two modules with the same name are an error that naga
/// reports, and a capture in a graphics debugger stays readable.
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
        "/// Every pass.\npub struct Shaders {{\n{fields}}}\n\n/// Every pass, linked and validated when this crate was built.\n\
         pub static SHADERS: Shaders = Shaders {{\n{values}}};\n\nimpl Shaders {{\n    /// All passes, by name.\n    #[must_use]\n    \
         pub fn all(&self) -> [&Shader; {count}] {{\n        [{list}]\n    }}\n}}\n"
    ))
}
