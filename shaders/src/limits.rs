//! Resources of every pass against the default limits of WebGPU, which every browser guarantees
//! (<https://www.w3.org/TR/webgpu/#limits>).
//!
//! A stage is counted over all entry points of its pass: the client gives them one pipeline layout.

use std::fmt::Write as _;

use naga::proc::Layouter;
use naga::valid::ModuleInfo;
use naga::{AddressSpace, Binding, EntryPoint, ImageClass, Module, ShaderStage, TypeInner};

use crate::SHADERS;
use crate::validate::validate;

/// The committed table of counts.
const TABLE: &str = include_str!("../../docs/shader-resources.md");

/// The limits that a stage is held to: name in WebGPU and value, in the order of [`Usage::counts`].
const LIMITS: [(&str, u32); 13] = [
    ("maxStorageBuffersPerShaderStage", 8),
    ("maxUniformBuffersPerShaderStage", 12),
    ("maxSampledTexturesPerShaderStage", 16),
    ("maxStorageTexturesPerShaderStage", 4),
    ("maxSamplersPerShaderStage", 16),
    ("maxBindGroups", 4),
    ("maxBindingsPerBindGroup", 1000),
    ("maxComputeInvocationsPerWorkgroup", 256),
    ("maxComputeWorkgroupSizeX", 256),
    ("maxComputeWorkgroupSizeY", 256),
    ("maxComputeWorkgroupSizeZ", 64),
    ("maxComputeWorkgroupStorageSize", 16_384),
    ("maxInterStageShaderVariables", 16),
];

/// Storage buffers that a stage of this project uses at most: one below the limit, as room for
/// measurements and debug views.
const STORAGE_BUFFERS: u32 = 7;

/// The text before the rows of [`TABLE`].
const HEADER: &str = "# Shader resources

Counts of every stage of every pass, by naga's reflection, against the [default limits of
WebGPU](https://www.w3.org/TR/webgpu/#limits). `shaders/src/limits.rs` checks them; after a change
`cargo xtask bless resources --write` writes this table.

| pass | stage | storage buffers | uniform buffers | sampled textures | storage textures | \
samplers | bind groups | invocations | workgroup bytes | inter-stage variables |
| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |
| **limit** | | 8 | 12 | 16 | 4 | 16 | 4 | 256 | 16384 | 16 |
";

/// The resources that one stage of a pass uses.
#[derive(Clone, Copy, Debug, Default)]
struct Usage {
    storage_buffers: u32,
    uniform_buffers: u32,
    sampled_textures: u32,
    storage_textures: u32,
    samplers: u32,
    bind_groups: u32,
    bindings: u32,
    workgroup_size: [u32; 3],
    workgroup_bytes: u32,
    inter_stage: u32,
}

impl Usage {
    fn counts(&self) -> [u32; 13] {
        let [x, y, z] = self.workgroup_size;
        [
            self.storage_buffers,
            self.uniform_buffers,
            self.sampled_textures,
            self.storage_textures,
            self.samplers,
            self.bind_groups,
            self.bindings,
            x * y * z,
            x,
            y,
            z,
            self.workgroup_bytes,
            self.inter_stage,
        ]
    }

    /// The limits that are exceeded.
    fn excesses(&self) -> Vec<String> {
        let counts = self.counts().into_iter().zip(LIMITS);
        let exceeded = counts.filter(|(count, (_, limit))| count > limit);
        exceeded.map(|(count, (name, limit))| format!("{name}: {count}, limit {limit}")).collect()
    }
}

/// Variables with a location in an argument or result of an entry point.
fn locations(module: &Module, ty: naga::Handle<naga::Type>, binding: Option<&Binding>) -> u32 {
    if let Some(binding) = binding {
        return u32::from(matches!(binding, Binding::Location { .. }));
    }
    let TypeInner::Struct { members, .. } = &module.types[ty].inner else { return 0 };
    let located = members.iter().filter(|member| matches!(member.binding, Some(Binding::Location { .. })));
    located.count() as u32
}

/// Variables that pass from the vertex to the fragment stage.
fn inter_stage(module: &Module, entry: &EntryPoint) -> u32 {
    match entry.stage {
        ShaderStage::Vertex => entry
            .function
            .result
            .as_ref()
            .map_or(0, |result| locations(module, result.ty, result.binding.as_ref())),
        ShaderStage::Fragment => entry
            .function
            .arguments
            .iter()
            .map(|argument| locations(module, argument.ty, argument.binding.as_ref()))
            .sum(),
        _ => 0,
    }
}

/// The resources that the entry points of one stage use together; none if the pass has no such
/// stage.
fn usage(module: &Module, info: &ModuleInfo, stage: ShaderStage) -> Option<Usage> {
    let mut layouter = Layouter::default();
    layouter.update(module.to_ctx()).expect("a validated module has a layout");
    let entries = || module.entry_points.iter().enumerate().filter(|(_, entry)| entry.stage == stage);
    entries().next()?;
    let mut usage = Usage::default();
    for (_, entry) in entries() {
        usage.inter_stage = usage.inter_stage.max(inter_stage(module, entry));
        for axis in 0..3 {
            usage.workgroup_size[axis] = usage.workgroup_size[axis].max(entry.workgroup_size[axis]);
        }
    }
    for (handle, variable) in module.global_variables.iter() {
        if entries().all(|(index, _)| info.get_entry_point(index)[handle].is_empty()) {
            continue;
        }
        match (variable.space, &module.types[variable.ty].inner) {
            (AddressSpace::Storage { .. }, _) => usage.storage_buffers += 1,
            (AddressSpace::Uniform, _) => usage.uniform_buffers += 1,
            (AddressSpace::WorkGroup, _) => {
                // WebGPU rounds the size of every variable up to 16 bytes.
                usage.workgroup_bytes += layouter[variable.ty].size.next_multiple_of(16);
            }
            (AddressSpace::Handle, TypeInner::Image { class: ImageClass::Storage { .. }, .. }) => {
                usage.storage_textures += 1;
            }
            (AddressSpace::Handle, TypeInner::Sampler { .. }) => usage.samplers += 1,
            (AddressSpace::Handle, _) => usage.sampled_textures += 1,
            _ => {}
        }
        if let Some(binding) = &variable.binding {
            usage.bind_groups = usage.bind_groups.max(binding.group + 1);
            usage.bindings = usage.bindings.max(binding.binding + 1);
        }
    }
    Some(usage)
}

/// The usage of every stage of a shader.
fn stages(name: &str, wgsl: &str) -> Vec<(&'static str, Usage)> {
    let (module, info) = validate(name, wgsl).unwrap_or_else(|complaint| panic!("{complaint}"));
    let stages = [
        ("vertex", ShaderStage::Vertex),
        ("fragment", ShaderStage::Fragment),
        ("compute", ShaderStage::Compute),
    ];
    stages.into_iter().filter_map(|(label, stage)| Some((label, usage(&module, &info, stage)?))).collect()
}

/// The table of all counts as Markdown.
fn table() -> String {
    let mut text = HEADER.to_owned();
    for shader in SHADERS.all() {
        for (stage, usage) in stages(shader.name, shader.wgsl) {
            let [x, y, z] = usage.workgroup_size;
            let cells = [
                usage.storage_buffers,
                usage.uniform_buffers,
                usage.sampled_textures,
                usage.storage_textures,
                usage.samplers,
                usage.bind_groups,
                x * y * z,
                usage.workgroup_bytes,
                usage.inter_stage,
            ];
            let cells = cells.map(|count| if count == 0 { "-".to_owned() } else { count.to_string() });
            writeln!(text, "| `{}` | {stage} | {} |", shader.name, cells.join(" | ")).expect("a string");
        }
    }
    text
}

#[test]
fn every_stage_keeps_within_the_default_limits_of_webgpu() {
    for shader in SHADERS.all() {
        for (stage, usage) in stages(shader.name, shader.wgsl) {
            let excesses = usage.excesses();
            assert!(excesses.is_empty(), "{}, {stage}: {excesses:?}", shader.name);
            assert!(usage.storage_buffers <= STORAGE_BUFFERS, "{}, {stage}: {usage:?}", shader.name);
        }
    }
}

#[test]
fn the_table_of_resources_is_current() {
    let table = table();
    if std::env::var_os("TOMBOLO_BLESS").is_some() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/shader-resources.md");
        std::fs::write(path, table).expect("docs/shader-resources.md");
        return;
    }
    assert_eq!(table, TABLE, "`cargo xtask bless resources --write` writes docs/shader-resources.md");
}

#[test]
fn shaders_beyond_a_limit_are_reported() {
    let buffers = |count: u32| -> String {
        let bindings = (0..count)
            .map(|n| format!("@group(0) @binding({n}) var<storage, read_write> b{n}: array<u32>;\n"))
            .collect::<String>();
        let uses = (0..count).map(|n| format!("    b{n}[0] = 1u;\n")).collect::<String>();
        format!("{bindings}@compute @workgroup_size(64) fn over() {{\n{uses}}}")
    };
    let excesses = |wgsl: &str| stages("control", wgsl)[0].1.excesses();
    assert_eq!(excesses(&buffers(8)), Vec::<String>::new());
    assert_eq!(excesses(&buffers(9)), ["maxStorageBuffersPerShaderStage: 9, limit 8"]);
    let wide = "@compute @workgroup_size(16, 32) fn over() {}";
    assert_eq!(excesses(wide), ["maxComputeInvocationsPerWorkgroup: 512, limit 256"]);
    let shared =
        "var<workgroup> big: array<u32, 4097>;\n@compute @workgroup_size(1) fn over() { big[0] = 1u; }";
    assert_eq!(excesses(shared), ["maxComputeWorkgroupStorageSize: 16400, limit 16384"]);
    let group = "@group(4) @binding(0) var<uniform> u: vec4f;\n\
                 @fragment fn over() -> @location(0) vec4f { return u; }";
    assert_eq!(excesses(group), ["maxBindGroups: 5, limit 4"]);
}
