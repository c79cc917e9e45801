#!/usr/bin/env bash
# Put a software Vulkan device (SwiftShader, from Debian's chromium-common) under .vulkan/, without
# installing anything on the system, and print what to export so that SAPIEN finds it.
# Works on Debian and on Ubuntu releases that package Chromium as a .deb.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
dir="$root/.vulkan"
if [ ! -f "$dir/swiftshader_icd.json" ]; then
  tmp=$(mktemp -d)
  trap 'rm -rf "$tmp"' EXIT
  chmod 755 "$tmp"
  (
    cd "$tmp"
    apt-get download -qq chromium-common libvulkan1 2>/dev/null ||
      { apt-get update -qq && apt-get download -qq chromium-common libvulkan1; }
    mkdir -p root "$dir"
    dpkg-deb --fsys-tarfile chromium-common_*.deb | tar -C root -x --wildcards '*libvk_swiftshader.so'
    dpkg-deb --fsys-tarfile libvulkan1_*.deb | tar -C root -x --wildcards '*libvulkan.so*'
    find root \( -name 'libvk_swiftshader.so' -o -name 'libvulkan.so*' \) -exec cp -P {} "$dir/" \;
  )
  cat > "$dir/swiftshader_icd.json" <<JSON
{"file_format_version": "1.0.0", "ICD": {"library_path": "$dir/libvk_swiftshader.so", "api_version": "1.3.0"}}
JSON
fi
echo "export VK_ICD_FILENAMES=$dir/swiftshader_icd.json"
