// The recording is in the page.
async function begin() {
  for (const element of document.querySelectorAll("script.chunk")) await recording.append(JSON.parse(element.textContent));
  opened();
}
begin();
