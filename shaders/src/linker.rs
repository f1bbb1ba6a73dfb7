//! Links every pass with its shared modules and validates it. What is committed has to equal the
//! result; with `TOMBOLO_BLESS` set the test writes it.
//!
//! A pass is a file directly under `wgsl/`, a shared module one under `wgsl/shared/`; modules under
//! `wgsl/bound/` may declare bindings, for passes that read the same buffers. The shared module
//! `constants` is no file: it is written here from `terrain::constants`, so no number exists twice.
//! Errors of all passes are collected.
//!
//! Linked in a test and not by a build script: the compiler of the shading language takes as long
//! to build as a quarter of the viewer (`docs/decisions/705-dist-profile.md`).

use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use terrain::base::LATTICES;
use terrain::constants as land;
use terrain::pyramid::PYRAMID_TEXELS;
use terrain::spline;
use wesl::syntax::{GlobalDeclaration, ModulePath, PathOrigin};
use wesl::{ManglerKind, SourceMap as _, VirtualResolver, Wesl};

use crate::validate::validate;

/// Contents of committed files by their path in this package.
type Files = BTreeMap<String, String>;

/// Links all passes: a file of WGSL for each, and the Rust that names them.
///
/// # Errors
/// What is wrong with each invalid pass.
fn link_all(folder: &Path) -> Result<Files, Box<dyn Error>> {
    let mut modules = vec![(module_path(&["shared", "constants"]), constants())];
    for name in ["shared", "bound"] {
        for (stem, source) in sources(&folder.join(name))? {
            modules.push((module_path(&[name, &stem]), source));
        }
    }

    let mut linked = Vec::new();
    let mut complaints = Vec::new();
    for (stem, source) in sources(folder)? {
        match link(&stem, &source, &modules).and_then(|wgsl| {
            let (module, _) = validate(&stem, &wgsl)?;
            Ok((wgsl, module))
        }) {
            Ok((wgsl, module)) => linked.push((stem, wgsl, module)),
            Err(complaint) => complaints.push(format!("{stem}.wesl: {complaint}")),
        }
    }
    if !complaints.is_empty() {
        return Err(complaints.join("\n").into());
    }

    let passes = ("src/passes.rs".into(), rust_source(&linked)?);
    let texts = linked.into_iter().map(|(stem, wgsl, _)| (format!("linked/{stem}.wgsl"), wgsl));
    Ok(texts.chain([passes]).collect())
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
    let mut linked = linker.compile(&root).map_err(|error| error.to_string())?;
    // The linker takes modules in the order of a hash table: the pass itself, which has no entry in
    // the map, stays first, and what it imports follows by name.
    let map = linked.sourcemap.take();
    linked.syntax.global_declarations.sort_by_cached_key(|declaration| {
        let name = match &**declaration {
            GlobalDeclaration::Declaration(declared) => &declared.ident,
            GlobalDeclaration::TypeAlias(declared) => &declared.ident,
            GlobalDeclaration::Struct(declared) => &declared.ident,
            GlobalDeclaration::Function(declared) => &declared.ident,
            GlobalDeclaration::Void | GlobalDeclaration::ConstAssert(_) => return None,
        };
        let name = name.name().to_string();
        map.get_decl(&name).is_some().then_some(name)
    });
    Ok(linked.to_string())
}

fn rust_source(linked: &[(String, String, naga::Module)]) -> Result<String, std::fmt::Error> {
    let (mut fields, mut values) = (String::new(), String::new());
    for (stem, _, module) in linked {
        let summary = format!("`wgsl/{stem}.wesl`, linked.");
        writeln!(fields, "    /// {summary}\n    pub {stem}: Shader,")?;
        writeln!(values, "    {stem}: Shader {{\n        name: {stem:?},")?;
        writeln!(values, "        wgsl: include_str!(\"../linked/{stem}.wgsl\"),\n        entry_points: &[")?;
        for entry in &module.entry_points {
            let (name, stage) = (&entry.name, entry.stage);
            writeln!(values, "            EntryPoint {{ name: {name:?}, stage: Stage::{stage:?} }},")?;
        }
        writeln!(values, "        ],\n    }},")?;
    }
    let list: String = linked.iter().map(|(stem, ..)| format!("            &self.{stem},\n")).collect();
    let count = linked.len();
    Ok(format!(
        "//! Every pass. Written by `cargo xtask bless shaders --write`.\n\n\
         use crate::{{EntryPoint, Shader, Stage}};\n\n\
         /// Every pass.\n#[derive(Debug)]\npub struct Shaders {{\n{fields}}}\n\n\
         /// Every pass, linked and validated.\n\
         pub static SHADERS: Shaders = Shaders {{\n{values}}};\n\n\
         impl Shaders {{\n    /// All passes, by name.\n    #[must_use]\n    \
         pub fn all(&self) -> [&Shader; {count}] {{\n        [\n{list}        ]\n    }}\n}}\n"
    ))
}

/// The committed files that [`link_all`] writes.
fn committed() -> Result<Files, Box<dyn Error>> {
    let mut files = Files::from([("src/passes.rs".into(), fs::read_to_string("src/passes.rs")?)]);
    for entry in fs::read_dir("linked")? {
        let path = entry?.path();
        files.insert(path.display().to_string(), fs::read_to_string(&path)?);
    }
    Ok(files)
}

/// Names of the files that only one side has, or that differ.
fn different<'a>(a: &'a Files, b: &'a Files) -> Vec<&'a str> {
    let differs = |path: &&String| a.get(*path) != b.get(*path);
    let new = b.keys().filter(|path| !a.contains_key(*path));
    a.keys().filter(differs).chain(new).map(String::as_str).collect()
}

#[test]
fn the_linked_passes_are_current() -> Result<(), Box<dyn Error>> {
    // Its text has lines and colours, which the result of a test would escape.
    let linked = link_all(Path::new("wgsl")).unwrap_or_else(|error| panic!("{error}"));
    if std::env::var_os("TOMBOLO_BLESS").is_some() {
        for path in committed().unwrap_or_default().keys().filter(|path| !linked.contains_key(*path)) {
            fs::remove_file(path)?;
        }
        for (path, text) in &linked {
            fs::write(path, text)?;
        }
    }
    let stale = committed()?;
    let stale = different(&stale, &linked);
    assert!(stale.is_empty(), "{stale:?}: link them with `cargo xtask bless shaders --write`");
    Ok(())
}

#[test]
fn a_pass_that_changed_is_new_or_is_gone_is_found() -> Result<(), Box<dyn Error>> {
    let mut files = committed()?;
    let before = files.clone();
    assert!(different(&before, &files).is_empty());
    let sky = files.get_mut("linked/draw_sky.wgsl").ok_or("no sky")?;
    *sky = sky.replacen("1", "2", 1);
    files.insert("linked/draw_more.wgsl".into(), String::new());
    files.remove("linked/tonemap.wgsl");
    let found = ["linked/draw_sky.wgsl", "linked/tonemap.wgsl", "linked/draw_more.wgsl"];
    assert_eq!(different(&before, &files), found);
    Ok(())
}

#[test]
fn an_invalid_pass_is_an_error_with_its_name() -> Result<(), Box<dyn Error>> {
    let folder = std::env::temp_dir().join(format!("tombolo-linker-{}", std::process::id()));
    for module in ["shared", "bound"] {
        fs::create_dir_all(folder.join(module))?;
    }
    fs::write(folder.join("shared/one.wesl"), "fn one() -> f32 { return 1.0; }\n")?;
    let pass = |result: &str| {
        format!(
            "import package::shared::one::one;\n\
             @fragment fn draw() -> @location(0) vec4f {{ return {result}; }}\n"
        )
    };
    fs::write(folder.join("good.wesl"), pass("vec4f(one())"))?;
    assert_eq!(link_all(&folder)?.len(), 2);
    fs::write(folder.join("bad.wesl"), pass("one()"))?;
    let error = link_all(&folder).err().ok_or("it is valid")?.to_string();
    assert!(error.starts_with("bad.wesl: ") && !error.contains("good.wesl"), "{error}");
    fs::remove_dir_all(folder)?;
    Ok(())
}
