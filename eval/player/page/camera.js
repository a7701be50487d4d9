// Camera image of this frame, or of the last kept one before it, with the pictures found in it.
let imageWanted = -1, imageShown = null;

function drawCamera() {
  const camera = recording.head.camera;
  $$("camera").hidden = !camera;
  if (!camera) return;
  const wanted = Math.max(after(camera.frames, S.frame) - 1, 0);
  if (wanted !== imageWanted) {
    imageWanted = wanted;
    const bytes = Uint8Array.from(atob(camera.images[wanted]), (c) => c.charCodeAt(0));
    createImageBitmap(new Blob([bytes])).then((image) => {
      if (wanted === imageWanted) { imageShown = { image, frame: camera.frames[wanted] }; changed(); }
    });
  }
  if (imageShown) paintCamera(imageShown.image, imageShown.frame, camera.width);
}

function paintCamera(image, frame, recordedWidth) {
  const canvas = $$("image"), times = 3, scale = (times * image.width) / recordedWidth;
  canvas.width = times * image.width; canvas.height = times * image.height;
  const g = canvas.getContext("2d");
  g.drawImage(image, 0, 0, canvas.width, canvas.height);
  const frames = recording.column("camera_frame"), picture = recording.column("camera_picture");
  const corners = recording.of("camera_corners"), names = [];
  for (let d = after(frames, frame - 0.5); d < frames.length && frames[d] < frame + 0.5; d++) {
    const at = [0, 1, 2, 3].map((c) => [(corners[2 * c][d] + 0.5) * scale, (corners[2 * c + 1][d] + 0.5) * scale]);
    for (const [colour, width] of [["#000", 6], ["#f0e442", 2.5]]) {
      g.strokeStyle = g.fillStyle = colour; g.lineWidth = width;
      g.beginPath(); at.forEach(([u, v], c) => (c ? g.lineTo(u, v) : g.moveTo(u, v))); g.closePath(); g.stroke();
      for (const [u, v] of at) { g.beginPath(); g.arc(u, v, 3 + width / 2, 0, 7); g.fill(); }
    }
    const name = String(Math.round(picture[d])), v = Math.max(at[0][1] - 34, 0);
    names.push(name);
    g.font = "bold 24px system-ui, sans-serif";
    g.fillRect(at[0][0] - 4, v, g.measureText(name).width + 12, 28);
    g.fillStyle = "#000"; g.fillText(name, at[0][0] + 2, v + 22);
  }
  const found = names.length ? `${names.length > 1 ? "pictures" : "picture"} ${names.join(", ")} found` : "no picture found";
  $$("image-note").textContent = `Camera, frame ${frame}: ${found}.`;
  canvas.setAttribute("aria-label", `Camera image of frame ${frame}, ${found}`);
}
