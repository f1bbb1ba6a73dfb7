//! The GPUs of this machine, software ones included.

/// Every adapter of some backends, and the instance that they belong to. Environment variables of
/// the drivers' loaders decide what there is to find.
pub fn all(backends: wgpu::Backends) -> (wgpu::Instance, Vec<wgpu::Adapter>) {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = backends;
    let instance = wgpu::Instance::new(descriptor);
    let adapters = pollster::block_on(instance.enumerate_adapters(backends));
    (instance, adapters)
}

/// Name and backend of an adapter, for people.
pub fn name(adapter: &wgpu::Adapter) -> String {
    let info = adapter.get_info();
    format!("{} ({})", info.name, info.backend)
}

/// The driver of an adapter and its version, as far as known, for people.
pub fn driver(adapter: &wgpu::Adapter) -> String {
    let info = adapter.get_info();
    let lines = |text: String| text.lines().map(str::trim).collect::<Vec<_>>().join("; ");
    let said: Vec<String> =
        [info.driver, info.driver_info].map(lines).into_iter().filter(|text| !text.is_empty()).collect();
    if said.is_empty() { "a driver without a name".into() } else { said.join(" ") }
}
