//! The GPUs of this machine, software ones included, each opened as portable WebGPU.

use anyhow::{Context, Result, bail};
use std::sync::{Arc, Mutex, PoisonError};

/// An open device.
#[derive(Debug)]
pub struct OpenGpu {
    /// Name, driver and backend, for people.
    pub name: String,
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    faults: Arc<Mutex<Option<String>>>,
}

/// Every adapter of some backends. Environment variables of the drivers' loaders decide what there
/// is to find.
pub fn all(backends: wgpu::Backends) -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = backends;
    let instance = wgpu::Instance::new(descriptor);
    pollster::block_on(instance.enumerate_adapters(backends))
}

/// Name, driver and backend of an adapter, for people.
pub fn name(adapter: &wgpu::Adapter) -> String {
    let info = adapter.get_info();
    format!("{} ({})", info.name, info.backend)
}

/// The driver of an adapter and its version, as far as known, for people.
pub fn driver(adapter: &wgpu::Adapter) -> String {
    let info = adapter.get_info();
    let said = [info.driver, info.driver_info].map(|text| one_line(&text));
    let said: Vec<String> = said.into_iter().filter(|text| !text.is_empty()).collect();
    if said.is_empty() { "a driver without a name".into() } else { said.join(" ") }
}

/// Opens an adapter with the limits that WebGPU guarantees everywhere.
pub fn open(adapter: &wgpu::Adapter) -> Result<OpenGpu> {
    let descriptor = wgpu::DeviceDescriptor { label: Some("lab"), ..Default::default() };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
        .map_err(|error| anyhow::anyhow!(one_line(&error.to_string())))
        .context("it cannot be opened with WebGPU's default limits")?;
    let faults = Arc::new(Mutex::new(None));
    let note = Arc::clone(&faults);
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
        // The first fault is the cause, later ones are its echoes.
        let fault = one_line(&error.to_string());
        note.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(fault);
    }));
    Ok(OpenGpu { name: name(adapter), device, queue, faults })
}

impl OpenGpu {
    /// Blocks until everything submitted is done.
    pub fn wait(&self) -> Result<()> {
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        match &*self.faults.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(fault) => bail!("the GPU failed: {fault}"),
            None => waited.map(|_| ()).context("the GPU does not respond"),
        }
    }
}

/// A driver's message as one line.
fn one_line(text: &str) -> String {
    text.lines().map(str::trim).filter(|line| !line.is_empty()).take(3).collect::<Vec<_>>().join("; ")
}
